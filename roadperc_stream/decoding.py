"""Input messages to datatypes, by what the role needs and how the message is written."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as PointCloudProto
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream import images, points
from roadperc_stream.channels import IMAGE_SCHEMA, POINTS_SCHEMA, TAG_TABLE_KEY, Kind
from roadperc_stream.datatypes import (
    Boundary,
    Box,
    CameraImage,
    DepthImage,
    Detection,
    HeightGrid,
    Lanes,
    Object,
    Objects,
    PointCloud,
    Side,
    Surface,
    TagImage,
)
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Camera, Float, Float32, Lens, Plane, pinhole_fault, rigid, rotation_from_quaternion
from roadperc_stream.schemas import ros2
from roadperc_stream.schemas.protobuf import stamp_ns
from roadperc_stream.schemas.roadperc_pb2 import Detections as DetectionsProto
from roadperc_stream.schemas.roadperc_pb2 import Lanes as LanesProto
from roadperc_stream.schemas.roadperc_pb2 import Objects as ObjectsProto
from roadperc_stream.schemas.roadperc_pb2 import Surface as SurfaceProto
from roadperc_stream.semantics import TABLES, TagTable

_END_OF_TIME_NS: Final = 2**63
_INTRINSICS: Final = (0, 4, 2, 5)
"""Where fx, fy, cx and cy stand in K, row by row."""
_SIDE_OF: Final[Mapping[int, Side]] = {1: "left", 2: "right"}


@dataclass(frozen=True)
class Transform:
    """One edge of the transform tree: ``parent_T_child``."""

    parent: str
    child: str
    parent_T_child: Float


Payload = (
    CameraImage
    | TagImage
    | DepthImage
    | PointCloud
    | Camera
    | tuple[Detection, ...]
    | tuple[Transform, ...]
    | Transform
    | Surface
    | Lanes
    | Objects
)


@dataclass(frozen=True)
class Decoded:
    """A message's own stamp (0 where it has none) and its content."""

    stamp_ns: int
    payload: Payload


@dataclass(frozen=True)
class Context:
    """What a decoder may need beside the bytes."""

    tag_table: TagTable | None = None


def _image(data: bytes, _: Context) -> Decoded:
    message = CompressedImage.FromString(data)
    content = message.data
    image = CameraImage(message.frame_id, lambda: images.decode_bgr(content), lambda: images.decode_grey(content))
    return Decoded(stamp_ns(message.timestamp), image)


def _tags(data: bytes, context: Context) -> Decoded:
    message = CompressedImage.FromString(data)
    content = message.data
    if context.tag_table is None:
        raise DecodeError("the log does not say its tag table; set tag_table, such as --set tag_table=0.9.15")
    return Decoded(
        stamp_ns(message.timestamp),
        TagImage(message.frame_id, context.tag_table, lambda: images.decode_indices(content)),
    )


def _ros_depth(data: bytes, _: Context) -> Decoded:
    stamp, frame_id = ros2.unpack_header(data)
    return Decoded(stamp, DepthImage(frame_id, lambda: _ros_depth_m(data)))


def _ros_depth_m(data: bytes) -> tuple[Float32, float]:
    image = ros2.unpack_image(data)
    if image.pixels.dtype.kind == "u":
        return images.depth_from_mm(image.pixels), images.DEPTH_LIMIT_MM / 1000
    depth_m = image.pixels.astype(np.float32)
    depth_m[~(depth_m > 0)] = np.nan
    return depth_m, np.inf


def _points(data: bytes, _: Context) -> Decoded:
    message = PointCloudProto.FromString(data)
    return Decoded(stamp_ns(message.timestamp), PointCloud(message.frame_id, lambda: _points_m(message)))


def _points_m(message: Any) -> Float32:
    """Points in the frame the message names: its pose, where it states one, places them there."""
    stated = message.HasField("pose")
    return points.unpack_points(
        message, _pose_matrix(message.pose.position, message.pose.orientation) if stated else np.eye(4)
    )


def _calibration(data: bytes, _: Context) -> Decoded:
    message = CameraCalibration.FromString(data)
    return Decoded(stamp_ns(message.timestamp), camera_from_calibration(message))


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


def _detections(data: bytes, _: Context) -> Decoded:
    message = DetectionsProto.FromString(data)
    return Decoded(stamp_ns(message.timestamp), tuple(detection_from_proto(d) for d in message.detections))


def detection_from_proto(message: Any) -> Detection:
    """One detection of a roadperc.Detections or roadperc.Objects."""
    box = Box(message.box_px.x_min, message.box_px.y_min, message.box_px.x_max, message.box_px.y_max)
    _require_finite(f"detection {message.label!r}", box.x_min, box.y_min, box.x_max, box.y_max, message.score)
    return Detection(message.label, box, float(message.score), message.id)


def _transforms(data: bytes, _: Context) -> Decoded:
    message = FrameTransforms.FromString(data)
    edges = tuple(
        Transform(t.parent_frame_id, t.child_frame_id, _pose_matrix(t.translation, t.rotation))
        for t in message.transforms
    )
    stamp = stamp_ns(message.transforms[0].timestamp) if edges else 0
    return Decoded(stamp, edges)


def _pose(data: bytes, _: Context) -> Decoded:
    message = PoseInFrame.FromString(data)
    matrix = _pose_matrix(message.pose.position, message.pose.orientation)
    return Decoded(stamp_ns(message.timestamp), Transform(message.frame_id, "ego", matrix))


def _pose_matrix(position: Any, orientation: Any) -> Float:
    try:
        rotation = rotation_from_quaternion(orientation.x, orientation.y, orientation.z, orientation.w)
    except ValueError as error:
        raise DecodeError(f"pose without an orientation: {error}") from error
    _require_finite("pose", position.x, position.y, position.z)
    return rigid(rotation, np.array([position.x, position.y, position.z]))


def _require_finite(what: str, *values: float | None) -> None:
    if not np.isfinite([value for value in values if value is not None]).all():
        raise DecodeError(f"{what}: a number is not finite")


def _optional(message: Any, name: str) -> Any:
    return getattr(message, name) if message.HasField(name) else None


def _surface(data: bytes, _: Context) -> Decoded:
    message = SurfaceProto.FromString(data)
    normal = np.array([message.normal.x, message.normal.y, message.normal.z])
    if not np.linalg.norm(normal) > 0:
        raise DecodeError("surface without a normal")
    grid = message.height_grid
    _require_finite("surface", *normal, message.camera_height_m, message.a, message.b, message.d, *grid.z_m)
    surface = Surface(
        source="truth",
        frame_id=message.frame_id,
        plane=Plane.of(normal, message.camera_height_m),
        ego_plane=Plane.of(np.array([message.a, message.b, 1.0]), -message.d),
        camera_height_m=message.camera_height_m,
        pitch=message.pitch,
        roll=message.roll,
        inlier_ratio=_optional(message, "inlier_ratio"),
        height_grid=HeightGrid(
            grid.x_min_m, grid.y_min_m, grid.step_m, np.array(grid.z_m, np.float32).reshape(grid.rows, grid.columns)
        )
        if message.HasField("height_grid")
        else None,
    )
    return Decoded(stamp_ns(message.timestamp), surface)


def _lanes(data: bytes, _: Context) -> Decoded:
    message = LanesProto.FromString(data)
    return Decoded(
        stamp_ns(message.timestamp), Lanes(tuple(_boundary(b) for b in message.boundaries if b.side in _SIDE_OF))
    )


def _boundary(message: Any) -> Boundary:
    line = np.array([(p.x, p.y, p.z) for p in message.line_ego_m]).reshape(-1, 3)
    _require_finite("boundary", message.offset_m, message.heading, message.curvature_per_m, *line.ravel())
    return Boundary(
        side=_SIDE_OF[message.side],
        status="measured",
        offset_m=_optional(message, "offset_m"),
        heading=_optional(message, "heading"),
        curvature_per_m=_optional(message, "curvature_per_m"),
        inside=message.inside,
        outside=message.outside,
        line_ego_m=line,
    )


def _objects(data: bytes, _: Context) -> Decoded:
    message = ObjectsProto.FromString(data)
    _require_finite("objects", *(v for o in message.objects for v in (o.distance_m, o.closing_speed_mps)))
    objects = tuple(
        Object(
            detection=detection_from_proto(o.detection),
            kept=o.kept,
            distance_m=_optional(o, "distance_m"),
            closing_speed_mps=_optional(o, "closing_speed_mps"),
            track_id=o.track_id,
        )
        for o in message.objects
    )
    return Decoded(stamp_ns(message.timestamp), Objects(objects))


DECODERS: Final[Mapping[tuple[Kind, str, str], Callable[[bytes, Context], Decoded]]] = {
    ("image", IMAGE_SCHEMA, "protobuf"): _image,
    ("tags", IMAGE_SCHEMA, "protobuf"): _tags,
    ("depth", ros2.IMAGE, "cdr"): _ros_depth,
    ("points", POINTS_SCHEMA, "protobuf"): _points,
    ("calibration", "foxglove.CameraCalibration", "protobuf"): _calibration,
    ("detections", "roadperc.Detections", "protobuf"): _detections,
    ("tf", "foxglove.FrameTransforms", "protobuf"): _transforms,
    ("pose", "foxglove.PoseInFrame", "protobuf"): _pose,
    ("surface", "roadperc.Surface", "protobuf"): _surface,
    ("lanes", "roadperc.Lanes", "protobuf"): _lanes,
    ("objects", "roadperc.Objects", "protobuf"): _objects,
}


def schemas_of_kind(kind: Kind) -> tuple[tuple[str, str], ...]:
    """(schema, message encoding) pairs that can serve a kind of role."""
    return tuple((schema, encoding) for known, schema, encoding in DECODERS if known == kind)


def context_of(metadata: Mapping[str, str], configured: str) -> Context:
    """Decoding context of a channel; the configured tag table (not ``auto``) wins over the channel's own."""
    name = metadata.get(TAG_TABLE_KEY, "") if configured == "auto" else configured
    return Context(TABLES.get(name))


def decode(kind: Kind, schema: str, encoding: str, data: bytes, log_time_ns: int, context: Context) -> Decoded:
    """Decode one message; a message without a stamp of its own gets its log time.

    Raises:
        DecodeError: the bytes are not what the schema promises.

    """
    try:
        decoded = DECODERS[kind, schema, encoding](data, context)
    except (ProtobufError, ValueError) as error:
        raise DecodeError(f"{len(data)} bytes are no {schema}: {error}") from error
    decoded = decoded if decoded.stamp_ns else replace(decoded, stamp_ns=log_time_ns)
    if not 0 <= decoded.stamp_ns < _END_OF_TIME_NS:
        raise DecodeError(f"stamp {decoded.stamp_ns} ns does not fit 64 bits")
    return decoded
