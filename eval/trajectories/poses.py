"""The poses of a run, estimated and true."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from roadperc_stream.core.geometry import Float


@dataclass(frozen=True)
class RunPoses:
    """The poses of one run, and how many of its frames have them.

    ``estimated`` and ``true`` are (N, 4, 4), from the ego frame to the run's odom frame and to the truth's own, in
    metres, of the same N frames, stamped ``stamps_ns`` (N,): those with both. Of a log without truth ``true`` is None,
    and N counts the estimated poses. ``segments`` (N,) says which belong together: from one to the next neither the
    odom frame nor the truth's need go on.

    A ``lost`` frame has no estimate: its row repeats the last pose known. Of the ``steps`` between estimates, those
    ``without_scale`` have a direction but no length in metres.
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
        """The poses of each segment, in the order of their frames; the counts stay the run's."""
        return {int(segment): self._of(self.segments == segment) for segment in dict.fromkeys(self.segments.tolist())}

    def _of(self, these: NDArray[np.bool_]) -> "RunPoses":
        true = None if self.true is None else self.true[these]
        return replace(
            self,
            stamps_ns=self.stamps_ns[these],
            estimated=self.estimated[these],
            true=true,
            segments=self.segments[these],
        )

    @property
    def up_to_scale(self) -> bool:
        """Whether most steps have no scale, so that the path's lengths are in a unit of its own."""
        return 2 * self.without_scale > self.steps

    @property
    def coverage(self) -> float:
        """Share of the run's frames whose pose is here, 0 to 1."""
        return len(self.stamps_ns) / self.frames


def pose_matrices(rows: Float) -> Float:
    """(N, 4, 4) transforms of (N, 7) rows x, y, z in metres and a quaternion x, y, z, w of any length but zero."""
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, 3] = rows[:, :3]
    poses[:, :3, :3] = Rotation.from_quat(rows[:, 3:]).as_matrix()
    return poses
