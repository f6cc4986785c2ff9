"""Patches around the keyframe's features, aligned with a frame at the pixels that a motion predicts.

Inverse compositional alignment (Baker and Matthews 2004) of a shift alone: the stretch follows from the motion and the
local planes. Features that matching lost are found again where the motion predicts them, as in SVO (Forster, Pizzoli
and Scaramuzza 2014).
"""

from typing import Final

import cv2
import numpy as np

from roadperc_stream.chain.stages.odometry.keyframes import Keyframe
from roadperc_stream.chain.stages.odometry.local_planes import stretch
from roadperc_stream.chain.stages.odometry.tracking_frame import TrackingFrame
from roadperc_stream.core.datatypes import Image
from roadperc_stream.core.geometry import Float, Float32, project, transform

_REACH_PX = 5
_ITERATIONS = 4
_FARTHEST_PX = 1.5
"""Shift beyond which the alignment has found something else."""
_LEAST_CORRELATION = 0.7
_FLAT: Final = 1e-3
"""Keeps patches without texture solvable; their correlation then sorts them out."""
_SIDE: Final = 2 * _REACH_PX + 1
_HALF: Final = np.float32(0.5)


def aligned(keyframe: Keyframe, frame: TrackingFrame, this_T_key: Float) -> Float32:
    """(N, 2) pixels of the keyframe's features in a frame, NaN where they do not look as predicted.

    Args:
        keyframe: with points and slopes.
        frame: the frame.
        this_T_key: the motion.
    """
    landmarks = keyframe.landmarks
    predicted = predicted_px(keyframe, frame, this_T_key)
    chosen = np.flatnonzero(np.isfinite(predicted[:, 0]) & np.isfinite(landmarks.slope[:, 0]))
    found = np.full_like(predicted, np.nan)
    if not len(chosen):
        return found
    key_px, start = landmarks.features.px[chosen], predicted[chosen]
    stretched = stretch(
        frame.camera, key_px.astype(float), landmarks.points_m[chosen, 2], landmarks.slope[chosen], this_T_key
    )
    px, correlation = _shifted(keyframe.grey, key_px, stretched.astype(np.float32), frame.grey, start)
    good = (np.linalg.norm(px - start, axis=1) < _FARTHEST_PX) & (correlation > _LEAST_CORRELATION)
    found[chosen[good]] = px[good]
    return found


def predicted_px(keyframe: Keyframe, frame: TrackingFrame, this_T_key: Float) -> Float32:
    """(N, 2) pixels where a motion predicts the features, NaN outside the image or on movable objects."""
    px = project(frame.camera, transform(this_T_key, keyframe.landmarks.points_m)).astype(np.float32)
    inside = ((px >= _REACH_PX) & (px <= np.array(frame.grey.shape[::-1]) - 1 - _REACH_PX)).all(axis=1)
    px[~inside] = np.nan
    px[frame.on_movable(px)] = np.nan
    return px


def _shifted(before: Image, key_px: Float32, stretch: Float32, grey: Image, start: Float32) -> tuple[Float32, Float32]:
    """(N, 2) pixels at which the stretched patches fit best near the start, and (N,) their correlation there."""
    around = _sampled(before.astype(np.float32), key_px[:, None] + _offsets(_REACH_PX + 1))
    wide = around.reshape(-1, _SIDE + 2, _SIDE + 2)
    template = _centred(wide[:, 1:-1, 1:-1].reshape(-1, _SIDE**2))
    right = _HALF * (wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2]).reshape(-1, _SIDE**2)
    down = _HALF * (wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1]).reshape(-1, _SIDE**2)
    gradient = np.stack((_centred(right), _centred(down)), axis=1)
    # Solved once for all iterations: the template does not change.
    H = gradient @ gradient.transpose(0, 2, 1) + _FLAT * np.eye(2, dtype=np.float32)
    gain = stretch @ np.linalg.solve(H, gradient)
    levels = grey.astype(np.float32)
    stretched = _offsets(_REACH_PX) @ stretch.transpose(0, 2, 1)
    px = start
    for _ in range(_ITERATIONS):
        px = px - (gain @ (_centred(_sampled(levels, px[:, None] + stretched)) - template)[..., None])[..., 0]
    found = _centred(_sampled(levels, px[:, None] + stretched))
    power = np.sum(found**2, axis=1) * np.sum(template**2, axis=1)
    return px, np.sum(found * template, axis=1) / np.sqrt(power + _FLAT)


def _offsets(reach: int) -> Float32:
    """(P, 2) pixels of a patch from its centre, row by row."""
    down, right = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    return np.stack((right, down), axis=-1).astype(np.float32)


def _centred(patches: Float32) -> Float32:
    """(N, P) without their means: so a change of brightness does not matter."""
    result: Float32 = patches - patches.mean(axis=1, keepdims=True)
    return result


def _sampled(image: Float32, px: Float32) -> Float32:
    """(N, P) grey levels of a float image, which remap does not round, at (N, P, 2) pixels, linear between them."""
    columns, rows = (np.ascontiguousarray(px[..., k]) for k in (0, 1))
    result: Float32 = np.asarray(
        cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32
    )
    return result
