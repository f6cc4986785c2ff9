"""Reads the estimated and true poses of a run, and exports them as files for other tools."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final, Literal

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.errors import TableError
from roadperc_stream.geometry import Float, inverse
from roadperc_stream.geometry.rotations import quaternion, rotations_from_quaternions
from roadperc_stream.system.files import write_whole
from roadperc_stream.system.time import NS_PER_S

from ..runs import Run, collect
from ..scan import SEGMENT, rows_of

_POSE: Final = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
ESTIMATED_COLUMNS: Final = tuple(f"odom_{name}" for name in _POSE)
TRUE_COLUMNS: Final = tuple(f"true_{name}" for name in _POSE)

_LARGEST: Final = 1e9
"""Largest absolute number of a pose; a larger one is an error of the log."""
_LEAST_NORM: Final = 1e-3
"""Least norm of a pose's quaternion: near zero it has no direction."""

PoseFormat = Literal["tum", "kitti"]


@dataclass(frozen=True)
class RunPoses:
    """The poses of one run, and the numbers of frames that have them.

    ``estimated`` and ``true`` are (N, 4, 4) in metres, from the ego frame to the odom frame and to the frame of the
    truth. Their N frames have both poses and the stamps ``stamps_ns`` (N,). Without truth ``true`` is None, and N is
    the number of estimated poses. ``segments`` (N,) are the log's segments: each may have another odom frame and
    another frame of the truth.

    A ``lost`` frame has no estimate; its row repeats the last known pose. Of the ``steps`` between estimates, those
    ``without_scale`` have no length in metres. Their frames have no estimate, or one up to scale.
    """

    name: str
    source: str
    frames: int
    lost: int
    estimated_frames: int
    true_frames: int
    steps: int
    without_scale: int
    stamps_ns: NDArray[np.int64]
    estimated: Float
    true: Float | None
    segments: NDArray[np.int64]

    @cached_property
    def of_segments(self) -> dict[int, "RunPoses"]:
        """The poses of each segment in frame order; the counts are those of the run."""
        parts = {}
        for segment_ in dict.fromkeys(self.segments.tolist()):
            these = self.segments == segment_
            arrays = {name: getattr(self, name)[these] for name in ("stamps_ns", "estimated", "segments")}
            parts[int(segment_)] = replace(self, **arrays, true=None if self.true is None else self.true[these])
        return parts

    @property
    def up_to_scale(self) -> bool:
        """Whether most estimates are up to scale, so that the path's unit of length is unknown."""
        return 2 * (self.steps - self.without_scale) < self.estimated_frames - 1

    @property
    def coverage(self) -> float:
        """Ratio of the N frames to all frames of the run."""
        return len(self.stamps_ns) / self.frames


def _pose_matrices(rows: Float) -> Float:
    """(N, 4, 4) transforms from (N, 7) rows: x, y, z in metres and a quaternion x, y, z, w of any norm except 0."""
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, 3] = rows[:, :3]
    poses[:, :3, :3] = rotations_from_quaternions(rows[:, 3:])
    return poses


def read_poses(run: Run) -> RunPoses:
    """Read a run's poses; a row that is no pose, such as one with a null, is missing.

    Raises:
        TableError: the table cannot be read, or no frame has an estimated pose.
    """
    kinds = {"odometry_status": pl.String(), "stamp_ns": pl.Int64()}
    kinds |= dict.fromkeys(("step_m", "turn_deg", *ESTIMATED_COLUMNS, *TRUE_COLUMNS), pl.Float64())
    columns = [pl.col(name).cast(kind) for name, kind in kinds.items()]
    table = collect(rows_of(run).select(SEGMENT, *columns), run.source_name)
    if run.next_run and not run.frames:
        raise TableError(run.why_empty)
    lost = (table["odometry_status"] == "lost").fill_null(value=False).to_numpy()
    estimated, true = (table.select(names).to_numpy() for names in (ESTIMATED_COLUMNS, TRUE_COLUMNS))
    has_estimate, has_truth = known_poses(estimated) & ~lost, known_poses(true)
    if not has_estimate.any():
        found = "no frame has an estimated pose (odom_x_m to odom_qw)"
        raise TableError(f"{run.source_name}: {found}; replay the log with odometry")
    used = has_estimate & has_truth if has_truth.any() else has_estimate
    turned = table["turn_deg"].is_not_null()
    return RunPoses(
        name=run.name,
        source=run.source_name,
        frames=run.frames,
        lost=int(lost.sum()),
        estimated_frames=int(has_estimate.sum()),
        true_frames=int(has_truth.sum()),
        steps=int(turned.sum()),
        without_scale=int((turned & table["step_m"].is_null()).sum()),
        stamps_ns=table["stamp_ns"].to_numpy()[used],
        estimated=_pose_matrices(estimated[used]),
        true=_pose_matrices(true[used]) if has_truth.any() else None,
        segments=table[SEGMENT].to_numpy()[used],
    )


def known_poses(rows: Float) -> NDArray[np.bool_]:
    """(N,) whether each of (N, 7) rows is a pose: it has no null or huge number, and its quaternion is not zero."""
    return np.asarray((np.abs(rows) <= _LARGEST).all(axis=1) & (np.linalg.norm(rows[:, 3:], axis=1) > _LEAST_NORM))


def export(folder: Path, run: RunPoses, suffix: PoseFormat) -> None:
    """Write NAME.est.SUFFIX and with truth NAME.true.SUFFIX, with ``tum_lines`` or ``kitti_lines``.

    If a run has several segments, each has its files: NAME.segment-0.est.tum and so on. NAME contains folders if other
    runs have the same file name.

    Raises:
        TargetError: a file cannot be written.
    """
    for number, part in run.of_segments.items():
        name = f"{run.name.lstrip('/')}.segment-{number}" if len(run.of_segments) > 1 else run.name.lstrip("/")
        for kind, poses in (("est", part.estimated), ("true", part.true)):
            if poses is not None:
                lines = tum_lines(part.stamps_ns, poses) if suffix == "tum" else kitti_lines(poses)
                write_whole(folder / f"{name}.{kind}.{suffix}", "".join(f"{line}\n" for line in lines))


def tum_lines(stamps_ns: NDArray[np.int64], poses: Float) -> list[str]:
    """A line for each of (N, 4, 4) poses: seconds with nine decimals, x y z in metres, quaternion x y z w.

    Numbers have enough digits to restore the float.
    Source: the file format of the TUM RGB-D benchmark (Sturm et al. 2012).
    """
    quaternions = np.array([quaternion(rotation) for rotation in poses[:, :3, :3]]).reshape(-1, 4)
    rows = np.hstack((poses[:, :3, 3], quaternions)).tolist()
    stamps = (divmod(stamp_ns, NS_PER_S) for stamp_ns in stamps_ns.tolist())
    return [f"{s}.{ns:09d} {_numbers(row)}" for (s, ns), row in zip(stamps, rows, strict=True)]


def kitti_lines(poses: Float) -> list[str]:
    """A line for each of (N, 4, 4) poses: the upper three rows of first_T_this, row by row, metres.

    Source: the file format of KITTI's odometry benchmark (Geiger et al. 2012), whose first pose is the identity.
    """
    first_T_this = inverse(poses[0]) @ poses
    return [_numbers(row) for row in first_T_this[:, :3].reshape(-1, 12).tolist()]


def _numbers(row: Iterable[float]) -> str:
    return " ".join(repr(value) for value in row)
