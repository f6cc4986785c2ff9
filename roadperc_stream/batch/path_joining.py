"""The path of a log that was replayed in parts: each part's poses, which begin anew, laid onto those before."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from roadperc_stream.core.geometry import Float

Rows = NDArray[np.int64]

_STANDING_M: Final = 1e-6
"""A path no longer than this tells no scale."""


@dataclass(frozen=True)
class PartPath:
    """The poses of a part's frames, in one odom frame.

    Args:
        poses: (N, 7) x, y, z and a unit quaternion x, y, z, w of odom_T_ego; NaN where a frame has none.
        known: (N,) whether a frame's pose is its own, and not the last one known.
        metric: whether the length of any step is known in metres.
    """

    poses: Float
    known: NDArray[np.bool_]
    metric: bool = True

    @property
    def there(self) -> Rows:
        """The rows with a pose, their own or an earlier one's."""
        return np.flatnonzero(np.isfinite(self.poses).all(axis=1))


@dataclass(frozen=True)
class PathMap:
    """Maps a part's odom frame to the one of the whole path: a point p to scale R p + translation_m.

    ``note`` says what the user should know of it.
    """

    rotation: Float
    translation_m: Float
    scale: float = 1.0
    note: str = ""

    def applied(self, poses: Float) -> Float:
        """(N, 7) poses, mapped: their places moved and scaled, their axes turned; NaN stays."""
        mapped, there = poses.copy(), np.isfinite(poses).all(axis=1)
        if there.any():
            mapped[there, :3] = self.scale * poses[there, :3] @ self.rotation.T + self.translation_m
            turned = Rotation.from_matrix(self.rotation) * Rotation.from_quat(poses[there, 3:])
            mapped[there, 3:] = turned.as_quat(canonical=True)
        return mapped


UNMOVED: Final = PathMap(np.eye(3), np.zeros(3))


def path_map(before: PartPath, after: PartPath, common: Rows) -> PathMap:
    """How a part's path goes on from the one before.

    By the frame nearest to the seam whose pose both parts know; where there is none, as in one pass where odometry is
    lost: from the last pose known.

    Args:
        before: what the part before has of the stretch in which the seam lies, in the odom frame of the whole path.
        after: what the part behind has of it.
        common: (M, 2) rows of the frames that both have, the seam first, then the nearest ones to it.
    """
    scale = _scale(before, after, common)
    both = common[before.known[common[:, 0]] & after.known[common[:, 1]]]
    if len(both):
        return _map(before.poses[both[0, 0]], after.poses[both[0, 1]], scale)
    last, first = before.there[before.there <= common[0, 0]], after.there[after.there >= common[0, 1]]
    if not (len(last) and len(first)):
        return UNMOVED
    note = "odometry is lost in all frames that the part before has too: the path goes on at the last pose known"
    return _map(before.poses[last[-1]], after.poses[first[0]], scale, note)


def _map(whole: Float, part: Float, scale: float, note: str = "") -> PathMap:
    """The map that takes one (7,) pose to the other."""
    rotation = (Rotation.from_quat(whole[3:]) * Rotation.from_quat(part[3:]).inv()).as_matrix()
    return PathMap(rotation, whole[:3] - scale * rotation @ part[:3], scale, note)


def _scale(before: PartPath, after: PartPath, common: Rows) -> float:
    """What a part's unit of length is in that of the path before: 1, but where the part does not know metres."""
    if after.metric:
        return 1.0
    both = np.sort(common[before.known[common[:, 0]] & after.known[common[:, 1]]], axis=0)
    lengths_m = [_length_m(path.poses[rows]) for path, rows in zip((before, after), both.T, strict=True)]
    return lengths_m[0] / lengths_m[1] if min(lengths_m) > _STANDING_M else 1.0


def _length_m(poses: Float) -> float:
    return float(np.sum(np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)))
