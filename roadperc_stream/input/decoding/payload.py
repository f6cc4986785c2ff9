"""The input and output types of decoders, and shared checks and conversions."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from roadperc_stream import model
from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import WITHOUT_CALIBRATION, DecodeError
from roadperc_stream.geometry import Camera, Float, Lens, pinhole_fault, rigid
from roadperc_stream.geometry.rotations import rotation_from_quaternion
from roadperc_stream.input.transforms import NOTHING_LATCHED, LatchedState
from roadperc_stream.model import Transform
from roadperc_stream.model.tag_tables import TagTable
from roadperc_stream.schemas import cdr
from roadperc_stream.schemas.protobuf import require_finite, stamp_ns
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES, Kind

Payload = (
    model.CameraImage
    | model.VideoFrame
    | model.TagImage
    | model.InstanceImage
    | model.DepthImage
    | model.PointCloud
    | Camera
    | tuple[model.Detection, ...]
    | tuple[model.Transform, ...]
    | model.Transform
    | model.Surface
    | model.Lanes
    | model.Objects
)
READ_AS_A_WHOLE: Final[frozenset[Kind]] = frozenset(("image", "video", "tags", "instances", "depth", "points"))
"""Kinds with one large block of data. The others have many items, so their messages have a size limit."""
_INTRINSICS: Final = (0, 4, 2, 5)
"""Indices of fx, fy, cx and cy in K, row by row."""


def without_slashes(payload: Payload) -> Payload:
    """The payload without leading slashes of its frames: ``/cam`` and ``cam`` are one frame, as in ROS 1."""
    found: Payload = tuple(map(_bare, payload)) if isinstance(payload, tuple) else _bare(payload)
    return found


def _bare(payload: Any) -> Any:
    names = {field: getattr(payload, field, "") for field in ("frame_id", "parent", "child")}
    slashed = {field: name.lstrip("/") for field, name in names.items() if name.startswith("/")}
    return replace(payload, **slashed) if slashed else payload


@dataclass(frozen=True, eq=False)
class Stamped:
    """A decoded message: its stamp and content, then its role and its place in the log.

    ``segment`` is the number of its segment. ``fault`` is why a reference message is left out. ``latched`` are the
    calibrations and transforms that hold for a reference message.
    """

    stamp_ns: int
    payload: Payload
    role: str = ""
    log_time_ns: int = 0
    segment: int = 0
    fault: str = ""
    latched: LatchedState = NOTHING_LATCHED

    @property
    def is_latched(self) -> bool:
        """Whether it holds until a later message replaces it."""
        return ROLES[self.role].kind in LATCHED_KINDS

    @property
    def edges(self) -> tuple[Transform, ...]:
        """The transforms of a transforms message; empty for any other."""
        parts = self.payload if isinstance(self.payload, tuple) else ()
        return tuple(part for part in parts if isinstance(part, Transform))


@dataclass(frozen=True)
class Context:
    """Settings of a decoder."""

    tag_table: TagTable | None = None
    definition: bytes = b""
    """The log's definition of a CDR message; empty for the definition of ROS 2."""
    definition_encoding: str = "ros2msg"
    limits: LimitsConfig = DEFAULT_LIMITS
    carla_bridge: bool = False
    """Whether CARLA's ROS bridge wrote it: its principal point counts from a pixel's corner."""


Contents = Callable[[Any, Context], Payload]
"""Makes the contents of a parsed message."""


def stamp_of(message: Any) -> int:
    """The stamp of a message, that of its first transform, or 0 without one."""
    if hasattr(message, "transforms"):
        return stamp_of(message.transforms[0]) if len(message.transforms) else 0
    stamp = message.header.stamp if hasattr(message, "header") else message.timestamp
    return stamp_ns(stamp) if hasattr(stamp, "seconds") else cdr.stamp_ns(stamp)


def frame_of(message: Any) -> str:
    """The frame of a message."""
    return str((message.header if hasattr(message, "header") else message).frame_id)


def pose_matrix(position: Any, orientation: Any) -> Float:
    """(4, 4) of a message's position and quaternion.

    Raises:
        DecodeError: a number is not finite, or the quaternion is not a rotation.
    """
    try:
        rotation = rotation_from_quaternion(orientation.x, orientation.y, orientation.z, orientation.w)
    except ValueError as error:
        raise DecodeError(f"pose without an orientation: {error}") from error
    require_finite("pose", position.x, position.y, position.z)
    return rigid(rotation, np.array([position.x, position.y, position.z]))


def require_count(items: Literal["points", "detections"], found: int, limits: LimitsConfig) -> None:
    """Check the number of items in a message.

    Raises:
        DecodeError: the message names the limit.
    """
    most: int = getattr(limits, items)
    if found > most:
        raise DecodeError(f"{found} {items}: expected {most} at most")


def camera_from_calibration(message: Any) -> Camera:
    """A camera of a foxglove.CameraCalibration, with the rectified intrinsics of P if given, else of K.

    If K, D and R describe an image that is not rectified yet, the camera has a lens.

    Raises:
        DecodeError: neither K nor P describes a possible pinhole camera, or there is no size.
    """
    K, P = list(message.K), list(message.P)
    if not any((*K, *P)):
        found = f"calibration of {message.frame_id!r}: all numbers are 0: expected a pinhole camera"
        raise DecodeError(found, WITHOUT_CALIBRATION)
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
    """The lens of the unrectified image; None if the image is rectified. R is unknown if it is all zero, as in ROS.

    The numbers are not checked here. Rectification checks them and reports an impossible lens.
    """
    R = tuple(_number(r) for r in message.R)
    if len(R) != 9 or not any(R):
        R = ()
        if not any(message.D):
            return None
    fx, fy, cx, cy = (_number(message.K[k]) for k in _INTRINSICS)
    as_taken = (fx, fy, cx, cy)
    if not any(message.D) and R == Lens.R and as_taken == rectified:
        return None
    return Lens(*as_taken, R, message.distortion_model)


def _number(value: float) -> float:
    """The number, with one single NaN object, so that equal calibrations compare equal."""
    return math.nan if math.isnan(value) else float(value)


def _intrinsics(K: list[float], P: list[float]) -> tuple[float, float, float, float]:
    if len(P) == 12 and P[0] > 0:
        return P[0], P[5], P[2], P[6]
    return (K[0], K[4], K[2], K[5]) if len(K) == 9 else (0.0, 0.0, 0.0, 0.0)
