"""Poses as files that other trajectory tools read."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from roadperc_stream.core.files import completing
from roadperc_stream.core.geometry import Float, inverse
from roadperc_stream.core.time import NS_PER_S

from .poses import RunPoses


def export_tum(folder: Path, run: RunPoses) -> None:
    """Write NAME.est.tum and, where there is truth, NAME.true.tum, each pose in its own world.

    Of a run in several segments each has its files: NAME.segment-0.est.tum and so on.

    Raises:
        TargetError: a file cannot be written.
    """
    for path, stamps_ns, poses in _targets(folder, run, "tum"):
        _write(path, tum_lines(stamps_ns, poses))


def export_kitti(folder: Path, run: RunPoses) -> None:
    """Write NAME.est.kitti and, where there is truth, NAME.true.kitti, each pose against its file's first.

    Of a run in several segments each has its files: NAME.segment-0.est.kitti and so on.

    Raises:
        TargetError: a file cannot be written.
    """
    for path, _, poses in _targets(folder, run, "kitti"):
        _write(path, kitti_lines(poses))


def tum_lines(stamps_ns: NDArray[np.int64], poses: Float) -> list[str]:
    """A line for each of (N, 4, 4) poses: seconds with nine decimals, x y z in metres, quaternion x y z w.

    Numbers have as many digits as give the same float again.
    Source: the file format of the TUM RGB-D benchmark (Sturm et al. 2012).
    """
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    rows = np.hstack((poses[:, :3, 3], quaternions)).tolist()
    stamps = (divmod(stamp_ns, NS_PER_S) for stamp_ns in stamps_ns.tolist())
    return [f"{s}.{ns:09d} {_numbers(row)}" for (s, ns), row in zip(stamps, rows, strict=True)]


def kitti_lines(poses: Float) -> list[str]:
    """A line for each of (N, 4, 4) poses: the upper three rows of first_T_this, row by row, metres.

    Source: the file format of KITTI's odometry benchmark (Geiger et al. 2012), whose paths begin at the identity.
    """
    first_T_this = inverse(poses[0]) @ poses
    return [_numbers(row) for row in first_T_this[:, :3].reshape(-1, 12).tolist()]


def _numbers(row: Iterable[float]) -> str:
    return " ".join(repr(value) for value in row)


def _targets(folder: Path, run: RunPoses, suffix: str) -> Iterator[tuple[Path, NDArray[np.int64], Float]]:
    """Files with their stamps and poses; a run that only its folder distinguishes from others gets that folder, too."""
    segments = run.of_segments
    for number, part in segments.items():
        name = f"{run.name.lstrip('/')}.segment-{number}" if len(segments) > 1 else run.name.lstrip("/")
        kinds = {"est": part.estimated} if part.true is None else {"est": part.estimated, "true": part.true}
        yield from ((folder / f"{name}.{kind}.{suffix}", part.stamps_ns, poses) for kind, poses in kinds.items())


def _write(path: Path, lines: Iterable[str]) -> None:
    with completing(path) as temporary:
        temporary.write_text("".join(f"{line}\n" for line in lines), encoding="ascii")
