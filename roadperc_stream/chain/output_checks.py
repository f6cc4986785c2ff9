"""Checks of the output of a stage of the user's own: types, shapes, and finite numbers."""

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Final

import numpy as np

from roadperc_stream.chain.encoding import MOST_BYTES, decode_plain, encode_plain
from roadperc_stream.errors import StateError
from roadperc_stream.geometry import Camera, Float
from roadperc_stream.model import Absent, Lanes, Objects, Odometry, StereoDepth, Surface
from roadperc_stream.model.scene import Scene

OUTPUTS: Final[Mapping[str, type]] = {
    "stereo": StereoDepth,
    "surface": Surface,
    "odometry": Odometry,
    "lanes": Lanes,
    "objects": Objects,
}
_MOST: Final = 2**31
"""Whole numbers are below this, as in messages; times are not."""
_PARTLY_UNKNOWN: Final = ("depth_m", "scores")
"""Arrays that may have values that are not finite."""
_RIGID: Final = 1e-6
_LEAST_UP: Final = 0.1


def checked(stage: str, output: object, seen: Scene | Camera) -> Any:
    """A copy of a stage's output, with the types that its class declares and read-only arrays.

    Args:
        stage: such as ``lanes``.
        output: returned by the stage.
        seen: the scene; for stereo the left camera.

    Raises:
        ValueError: the output cannot be used; the message names the field.
    """
    kind = OUTPUTS[stage]
    if not isinstance(output, (kind, Absent)):
        raise ValueError(f"expected {kind.__name__} or Absent, found {type(output).__name__}")  # noqa: TRY004
    try:
        copy: Any = decode_plain(encode_plain(output, MOST_BYTES), Absent if isinstance(output, Absent) else kind)
    except (TypeError, RecursionError, OverflowError, StateError) as error:
        raise ValueError(str(error)) from error
    _require_finite(copy, type(copy).__name__)
    match copy, seen:
        case StereoDepth(), Camera():
            _require(copy.depth_m.shape == seen.size, f"depth_m: expected {seen.size}, found {copy.depth_m.shape}")
            with np.errstate(invalid="ignore"):
                _require(not np.any((copy.depth_m <= 0) | np.isinf(copy.depth_m)), "depth_m: expected metres or NaN")
        case Surface(), Scene():
            _check_surface(copy, seen)
        case Odometry(), Scene():
            _check_odometry(copy, seen)
        case Lanes(), Scene():
            _check_lanes(copy, seen)
        case Objects(), Scene():
            for item in copy.objects:
                box = item.detection.box_px
                _require(box.x_min <= box.x_max and box.y_min <= box.y_max, f"box_px: maxima below minima in {box}")
        case Absent(), _:
            str(copy)  # its code and values must have a sentence
    return copy


def _require(holds: bool, fault: str) -> None:
    if not holds:
        raise ValueError(fault)


def _require_finite(value: Any, name: str) -> None:
    """Check all numbers of an output, to any depth."""
    if isinstance(value, np.ndarray):
        field = name.rpartition(".")[2]
        _require(field in _PARTLY_UNKNOWN or bool(np.isfinite(value).all()), f"{name}: expected finite numbers")
    elif isinstance(value, float):
        _require(math.isfinite(value), f"{name}: expected a finite number or None, found {value}")
    elif isinstance(value, int):
        _require(abs(value) < _MOST or name.endswith("_ns"), f"{name}: expected less than {_MOST}, found {value}")
    elif isinstance(value, tuple):
        for item in value:
            _require_finite(item, name)
    elif is_dataclass(value):
        for part in fields(value):
            _require_finite(getattr(value, part.name), f"{name}.{part.name}")


def _check_surface(surface: Surface, scene: Scene) -> None:
    cameras = {scene.camera.frame_id} if scene.depth is None else {scene.camera.frame_id, scene.depth.camera.frame_id}
    _require(surface.frame_id in cameras, f"frame_id: expected {' or '.join(sorted(cameras))}")
    for plane, name in ((surface.plane, "plane"), (surface.ego_plane, "ego_plane")):
        _require(math.isclose(math.hypot(*plane.normal), 1, abs_tol=_RIGID), f"{name}: expected a normal of length 1")
    _require(surface.ego_plane.normal[2] > _LEAST_UP, "ego_plane: expected a normal that points up")


def _check_odometry(motion: Odometry, scene: Scene) -> None:
    for matrix, name in ((motion.odom_T_ego, "odom_T_ego"), (motion.step, "step")):
        _require(matrix is None or _is_rigid(matrix), f"{name}: expected a rotation and a translation")
    _check_covariance(motion.covariance, 6)
    known = motion.step is not None and motion.since_ns is not None
    _require(motion.status != "tracked" or known, "step, since_ns: expected for a tracked frame")
    at_origin = not scene.is_origin or np.array_equal(motion.odom_T_ego, np.eye(4))
    _require(at_origin, "odom_T_ego: expected the identity, because scene.is_origin is True")


def _is_rigid(matrix: Float) -> bool:
    R = matrix[:3, :3]
    is_rotation = np.allclose(R @ R.T, np.eye(3), atol=_RIGID) and np.linalg.det(R) > 0
    return bool(is_rotation and np.array_equal(matrix[3], (0, 0, 0, 1)))


def _check_covariance(covariance: tuple[float, ...], size: int) -> None:
    count = len(covariance)
    _require(count in (0, size**2), f"covariance: expected {size**2} numbers or none, found {count}")
    _require(min(covariance[:: size + 1], default=0) >= 0, "covariance: expected variances of 0 or more")


def _check_lanes(lanes: Lanes, scene: Scene) -> None:
    sides = [boundary.side for boundary in lanes.boundaries]
    _require(len(sides) == len(set(sides)), f"boundaries: expected one for each side, found {', '.join(sides)}")
    for boundary in lanes.boundaries:
        _check_covariance(boundary.covariance, 3)
    edges = lanes.edges
    _require(edges is None or edges.shape == scene.camera.size, f"edges: expected the shape {scene.camera.size}")
