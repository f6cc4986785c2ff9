"""Features of the keyframe where a motion predicts them in a frame, aligned by their patches.

The alignment searches only a shift: the stretch follows from the motion and the local planes. It finds features that
matching lost where the motion predicts them, as in SVO (Forster, Pizzoli and Scaramuzza 2014).
"""

from typing import Final

import numpy as np

from roadperc_stream.chain.stages.odometry import keyframes
from roadperc_stream.chain.stages.odometry.features import TrackingFrame
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe
from roadperc_stream.geometry import Float, Float32, project, transform
from roadperc_stream.kernels import align_patches
from roadperc_stream.kernels.odometry_plain import REACH_PX

_MOST_ITERATIONS: Final = 20
_STILL_PX: Final = 0.01
"""Shift at which a patch has arrived. Noise slows down patches with little texture: most need 3 iterations, some 15."""
_FARTHEST_PX = 1.5
"""Largest shift of an alignment; larger ones are wrong."""
_LEAST_CORRELATION = 0.7


def aligned(keyframe: Keyframe, frame: TrackingFrame, this_T_key: Float) -> tuple[Float32, Float32]:
    """The keyframe's features aligned in a frame, and where the motion predicts them.

    Returns:
        (N, 2) pixels, NaN where they do not look as predicted; (N, 2) predicted ones, NaN outside the image or on
        movable objects.
    """
    landmarks = keyframe.landmarks
    predicted = _predicted_px(keyframe, frame, this_T_key)
    chosen = np.flatnonzero(np.isfinite(predicted[:, 0]) & np.isfinite(landmarks.slope[:, 0]))
    found = np.full_like(predicted, np.nan)
    if not len(chosen):
        return found, predicted
    key_px, start = landmarks.features.px[chosen], predicted[chosen]
    stretched = keyframes.stretch(
        frame.camera, key_px.astype(float), landmarks.points_m[chosen, 2], landmarks.slope[chosen], this_T_key
    )
    px = start.astype(float)
    correlation = align_patches(
        keyframe.grey, key_px.astype(float), stretched, frame.grey, px, _MOST_ITERATIONS, _STILL_PX
    )
    good = (np.linalg.norm(px - start, axis=1) < _FARTHEST_PX) & (correlation > _LEAST_CORRELATION)
    found[chosen[good]] = px[good]
    return found, predicted


def _predicted_px(keyframe: Keyframe, frame: TrackingFrame, this_T_key: Float) -> Float32:
    """(N, 2) pixels where a motion predicts the features, NaN outside the image or on movable objects."""
    px = project(frame.camera, transform(this_T_key, keyframe.landmarks.points_m)).astype(np.float32)
    inside = ((px >= REACH_PX) & (px <= np.array(frame.grey.shape[::-1]) - 1 - REACH_PX)).all(axis=1)
    px[~inside] = np.nan
    px[frame.on_movable(px)] = np.nan
    return px
