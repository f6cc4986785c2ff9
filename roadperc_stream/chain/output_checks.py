"""Checks of the output of a stage of the user's own: types, shapes, and finite numbers."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Final

import numpy as np

from roadperc_stream.chain.encoding import MOST_BYTES, decode_plain, encode_plain
from roadperc_stream.geometry import Camera, is_rotation
from roadperc_stream.geometry.ground import part
from roadperc_stream.model import Absent, Lanes, Objects, Odometry, StereoDepth, Surface
from roadperc_stream.model.frame import Frame

_MOST: Final = 2**31
"""Whole numbers are below this, as in messages; times are not."""
_PARTLY_UNKNOWN: Final = ("depth_m", "scores")
"""Arrays that may have values that are not finite."""
_LEAST_UP: Final = 0.1


def checked(stage: str, output: object, seen: Frame | Camera) -> Any:
    """A copy of a stage's output, with the types that its class declares; ``seen`` is the left camera for stereo.

    Raises:
        Exception: the output cannot be used; the message names the field.
    """
    kind, faults = OUTPUTS[stage]
    if not isinstance(output, (kind, Absent)):
        raise TypeError(f"expected {kind.__name__} or Absent, found {type(output).__name__}")
    copy: Any = decode_plain(encode_plain(output, MOST_BYTES), Absent if isinstance(output, Absent) else kind)
    if isinstance(copy, Absent):
        str(copy)  # its code and values must have a sentence
        return copy
    for fault in (*_faults_of_numbers(copy, kind.__name__), *faults(copy, seen)):
        raise ValueError(fault)
    return copy


def _faults_of_numbers(value: Any, name: str) -> Iterator[str]:
    """Faults of the numbers of an output, to any depth."""
    if isinstance(value, np.ndarray):
        if name.rpartition(".")[2] not in _PARTLY_UNKNOWN and not np.isfinite(value).all():
            yield f"{name}: expected finite numbers"
    elif isinstance(value, float) and not math.isfinite(value):
        yield f"{name}: expected a finite number or None, found {value}"
    elif isinstance(value, int) and abs(value) >= _MOST and not name.endswith("_ns"):
        yield f"{name}: expected less than {_MOST}, found {value}"
    elif isinstance(value, tuple):
        for item in value:
            yield from _faults_of_numbers(item, name)
    elif is_dataclass(value):
        for part in fields(value):
            yield from _faults_of_numbers(getattr(value, part.name), f"{name}.{part.name}")


def _faults_of_depth(output: StereoDepth, left: Camera) -> Iterator[str]:
    if output.depth_m.shape != left.size:
        yield f"depth_m: expected the shape {left.size}, found {output.depth_m.shape}"
    if not (np.isnan(output.depth_m) | ((output.depth_m > 0) & (output.depth_m < np.inf))).all():
        yield "depth_m: expected positive metres or NaN"


def _faults_of_surface(output: Surface, frame: Frame) -> Iterator[str]:
    cameras = {frame.camera.frame_id, frame.depth_camera.frame_id}
    if output.frame_id not in cameras:
        yield f"frame_id: expected {' or '.join(sorted(cameras))}, found {output.frame_id}"
    if output.ego_plane.normal[2] < _LEAST_UP:
        yield "ego_plane: expected a normal that points up"


def _faults_of_odometry(output: Odometry, frame: Frame) -> Iterator[str]:
    yield from _faults_of_covariance(output.covariance, 6)
    if not all(_is_rigid(matrix) for matrix in (output.odom_T_ego, output.step) if matrix is not None):
        yield "odom_T_ego, step: expected rotations and translations"
    if output.status == "tracked" and (output.step is None or output.since_ns is None):
        yield "step, since_ns: expected for a tracked frame"
    if frame.is_origin and not np.array_equal(output.odom_T_ego, np.eye(4)):
        yield "odom_T_ego: expected the identity, because frame.is_origin is True"


def _faults_of_lanes(output: Lanes, frame: Frame) -> Iterator[str]:
    for boundary in output.boundaries:
        yield from _faults_of_covariance(boundary.covariance, 3)
    if len({boundary.side for boundary in output.boundaries}) < len(output.boundaries):
        yield "boundaries: expected one for each side"
    sizes = frame.camera.size, part(frame.camera, 2, 2).size
    if output.edges is not None and output.edges.shape not in sizes:
        yield f"edges: expected the shape {sizes[0]} or {sizes[1]}, found {output.edges.shape}"


def _faults_of_covariance(covariance: tuple[float, ...], size: int) -> Iterator[str]:
    if len(covariance) not in (0, size**2) or min(covariance[:: size + 1], default=0) < 0:
        yield f"covariance: expected {size**2} numbers or none, with variances of 0 or more"


def _is_rigid(matrix: np.ndarray[Any, Any]) -> bool:
    return is_rotation(matrix[:3, :3], 1e-6) and np.array_equal(matrix[3], (0, 0, 0, 1))


OUTPUTS: Final[Mapping[str, tuple[type, Callable[[Any, Any], Iterable[str]]]]] = {
    "stereo": (StereoDepth, _faults_of_depth),
    "surface": (Surface, _faults_of_surface),
    "odometry": (Odometry, _faults_of_odometry),
    "lanes": (Lanes, _faults_of_lanes),
    "objects": (Objects, lambda *_: ()),
}
"""The type of each stage's output, and the faults of an output; the second argument is what the stage saw."""
