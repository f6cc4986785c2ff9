"""Other motions along the path that explain both images about as well: a repetitive texture has several.

Matched points agree on a wrong motion if all of them are shifted by one repetition, so their scatter shows nothing.
The features' patches are reprojected for many shifts along the path. A patch counts if it correlates with the image,
and if its depth agrees with that of the image. Unique things (a post, an edge, the end of a row) fit only the right
shift.
"""

from typing import Final

import cv2
import numpy as np

from roadperc_stream.chain.stages.odometry.features import TrackingFrame
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe
from roadperc_stream.geometry import Float, inverse, project, rigid, transform
from roadperc_stream.model import Image, Mask

_FARTHEST_M: Final = 2.0
_APART_M: Final = 0.04
"""Range of the tried shifts to either side, and their distance."""
_AS_GOOD: Final = 0.85
"""Share of the best score from which a shift cannot be excluded."""
_SAME_DEPTH: Final = 0.1
"""Largest relative difference of the depths of one point."""
_MOVES_PX: Final = 0.3
"""Least movement of a used point between two tried shifts: distant points fit all of them."""
_LEAST_POINTS: Final = 20
_MOST_POINTS: Final = 100
_PATCH_PX: Final = np.stack(np.meshgrid(*2 * (np.arange(-4.0, 5.0, 2.0),)), axis=-1).reshape(-1, 2)


def best_shift(keyframe: Keyframe, frame: TrackingFrame, this_T_key: Float) -> tuple[float, float]:
    """The shift of a motion along the car's path that fits best, in metres, and its standard deviation.

    The shift is 0 if the motion itself fits about as well. The deviation is 0 if no other shift does, else the distance
    to the farthest one. Both are 0 if too few points are near. The frame has depth.
    """
    shifts_m = np.arange(-_FARTHEST_M, _FARTHEST_M + _APART_M / 2, _APART_M)
    own = len(shifts_m) // 2
    points_m = np.array([transform(along_path(frame, s) @ this_T_key, keyframe.landmarks.points_m) for s in shifts_m])
    px = project(frame.camera, points_m)
    moves = np.linalg.norm(px[own + 1] - px[own], axis=1) > _MOVES_PX
    used = np.flatnonzero(moves)
    used = used[:: max(len(used) // _MOST_POINTS, 1)]
    if len(used) < _LEAST_POINTS:
        return 0.0, 0.0
    key_px, key_depth_m = keyframe.landmarks.features.px[used].astype(float), keyframe.landmarks.points_m[used, 2]
    key = _patches(keyframe.grey, key_px, np.ones(len(used)))
    points_m, px = points_m[:, used], px[:, used]
    inside, agrees = _seen(frame, px, points_m[..., 2])
    if not agrees.any():
        return 0.0, 0.0
    found = np.zeros((*px.shape[:2], len(_PATCH_PX)))
    found[agrees] = _patches(frame.grey, px[agrees], (key_depth_m / points_m[..., 2])[agrees])
    visible = np.sum(inside, axis=1)
    scores = np.einsum("snp,np->s", found, key) / np.maximum(visible, 1)
    return _judged(shifts_m, np.where(visible < _LEAST_POINTS, 0.0, scores))


def _judged(shifts_m: Float, scores: Float) -> tuple[float, float]:
    """Shift and deviation of ``best_shift`` by the (S,) scores of the shifts."""
    best, own = int(np.argmax(scores)), len(shifts_m) // 2
    group = np.cumsum(np.diff(scores >= _AS_GOOD * scores[best], prepend=False))  # odd within a run of good shifts
    chosen = own if group[own] % 2 else best
    rivals = (group % 2 == 1) & (group != group[chosen])
    shift_m = 0.0 if chosen == own else float(shifts_m[best])
    return shift_m, float(np.abs(shifts_m[rivals] - shift_m).max(initial=0.0))


def along_path(frame: TrackingFrame, shift_m: float) -> Float:
    """(4, 4) transform of points in the camera's frame if the car has driven farther by a shift."""
    return rigid(np.eye(3), -shift_m * inverse(frame.ego_T_camera)[:3, 0])


def _seen(frame: TrackingFrame, px: Float, depth_m: Float) -> tuple[Mask, Mask]:
    """(S, N) which (S, N, 2) pixels are in the image, and which of them have about their (S, N) depth there."""
    inside: Mask = ((px >= 0) & (px <= np.array(frame.grey.shape[::-1]) - 1)).all(axis=-1) & (depth_m > 0)
    agrees = inside.copy()
    if frame.depth_m is not None:
        columns, rows = np.rint(frame.whole(px[agrees].astype(np.float32))).astype(int).T
        with np.errstate(invalid="ignore"):
            agrees[agrees] = np.abs(frame.depth_m[rows, columns] / depth_m[agrees] - 1) < _SAME_DEPTH
    return inside, agrees


def _patches(grey: Image, px: Float, nearer: Float) -> Float:
    """(N, P) patches with zero mean and unit length around (N, 2) pixels, enlarged by (N,) factors."""
    at = (px[:, None] + nearer[:, None, None] * _PATCH_PX).astype(np.float32)
    columns, rows = (np.ascontiguousarray(at[..., axis]) for axis in (0, 1))
    levels = cv2.remap(grey, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)
    levels -= levels.mean(axis=1, keepdims=True)
    return np.asarray(levels / np.maximum(np.linalg.norm(levels, axis=1, keepdims=True), 1e-6))
