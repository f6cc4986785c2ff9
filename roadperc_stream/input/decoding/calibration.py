"""A camera of a calibration message."""

import math
from typing import Any, Final

import numpy as np

from roadperc_stream.core.geometry import Camera, Lens, pinhole_fault
from roadperc_stream.errors import DecodeError

_INTRINSICS: Final = (0, 4, 2, 5)
"""Where fx, fy, cx and cy stand in K, row by row."""


def camera_from_calibration(message: Any) -> Camera:
    """A camera of a foxglove.CameraCalibration; P, where it is given, holds the rectified intrinsics.

    K, D and R speak of the image as it is: where they say that it is not rectified yet, the camera has a lens.

    Raises:
        DecodeError: neither K nor P describes a pinhole that could be a camera, or there is no size.

    """
    K, P = list(message.K), list(message.P)
    intrinsics = _intrinsics(K, P)
    fx, fy, cx, cy = (float(value) for value in intrinsics)
    if not (np.isfinite(intrinsics).all() and fx > 0 and fy > 0 and message.width and message.height):
        size = f"{message.width}x{message.height}"
        raise DecodeError(f"calibration of {message.frame_id!r}: size {size}, K {K}: expected a pinhole camera")
    fault = pinhole_fault(message.width, message.height, fx, fy, cx, cy)
    if fault is not None:
        raise DecodeError(f"calibration of {message.frame_id!r}: {fault}")
    baseline_m = -P[3] / fx if len(P) == 12 and P[3] else None
    distortion = tuple(_number(d) for d in message.D) if any(message.D) else ()
    lens = _lens(message, (fx, fy, cx, cy)) if len(K) == 9 and any(K[k] for k in _INTRINSICS) else None
    return Camera(message.frame_id, message.width, message.height, fx, fy, cx, cy, baseline_m, distortion, lens)


def _lens(message: Any, rectified: tuple[float, float, float, float]) -> Lens | None:
    """How the image was taken; None where it is rectified as it stands, or R is not given (all zero, in ROS).

    What it says is not judged here: only who rectifies the image has to do without a lens that cannot be.
    """
    R = tuple(_number(r) for r in message.R)
    if len(R) != 9 or not any(R):
        return None
    fx, fy, cx, cy = (_number(message.K[k]) for k in _INTRINSICS)
    as_taken = (fx, fy, cx, cy)
    if not any(message.D) and R == Lens.R and as_taken == rectified:
        return None
    return Lens(*as_taken, R, message.distortion_model)


def _number(value: float) -> float:
    """The number, and always the same NaN: calibrations that say the same are then equal."""
    return math.nan if math.isnan(value) else float(value)


def _intrinsics(K: list[float], P: list[float]) -> tuple[float, float, float, float]:
    if len(P) == 12 and P[0] > 0:
        return P[0], P[5], P[2], P[6]
    return (K[0], K[4], K[2], K[5]) if len(K) == 9 else (0.0, 0.0, 0.0, 0.0)
