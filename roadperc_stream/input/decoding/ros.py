"""Decodes ROS 2 messages, by the definition in their log."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, sin
from typing import Any, Final

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField

from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import points
from roadperc_stream.formats.raster import Raster
from roadperc_stream.geometry import Float32
from roadperc_stream.input.decoding import pictures
from roadperc_stream.input.decoding.payload import Context, Stamped, camera_from_calibration, pose_matrix, require_count
from roadperc_stream.model import EGO, Box, Detection, PointCloud, Transform, VideoFrame
from roadperc_stream.schemas import cdr, ros2
from roadperc_stream.schemas.protobuf import require_finite
from roadperc_stream.schemas.roles import Kind

_FOXGLOVE_TYPES: Final = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}
"""foxglove type of each sensor_msgs/msg/PointField type."""

_TO_PIXEL_CENTRE: Final = 0.5


def _stamped(message: Any, payload: Any) -> Stamped:
    return Stamped(cdr.stamp_ns(message.header.stamp), payload)


def _frame_id(message: Any) -> str:
    return str(message.header.frame_id)


Decoder = Callable[[Any, Context], Stamped]


def _raw(kind: Kind) -> Decoder:
    """A decoder of sensor_msgs/msg/Image."""

    def decoded(message: Any, context: Context) -> Stamped:
        raster = Raster.of_ros(message)
        return _stamped(message, pictures.of_raster(kind, _frame_id(message), raster, context))

    return decoded


def _file(kind: Kind) -> Decoder:
    """A decoder of sensor_msgs/msg/CompressedImage."""

    def decoded(message: Any, context: Context) -> Stamped:
        pictures.require_picture(message.format)
        content = message.data.tobytes()
        return _stamped(message, pictures.of_file(kind, _frame_id(message), content, context))

    return decoded


def _compressed_image(message: Any, context: Context) -> Stamped:
    if "compressedDepth" in message.format:
        raise DecodeError(f"image of format {message.format!r}: that is depth, expected jpeg or png")
    return _file("image")(message, context)


def _compressed_depth(message: Any, context: Context) -> Stamped:
    content = message.data.tobytes()
    return _stamped(message, pictures.encoded_depth(_frame_id(message), message.format, content, context))


def _video(message: Any, _: Context) -> Stamped:
    """A frame of a foxglove_msgs/msg/CompressedVideo, which has no header, or of a sensor_msgs/msg/CompressedImage."""
    stamp, head = (message.header.stamp, message.header) if hasattr(message, "header") else (message.timestamp, message)
    return Stamped(cdr.stamp_ns(stamp), VideoFrame(head.frame_id, message.format, message.data.tobytes()))


def _calibration(message: Any, context: Context) -> Stamped:
    """A CameraInfo of the image as it is published.

    Raises:
        DecodeError: the calibration is of a cut or binned image, or not of a pinhole camera.
    """
    _require_whole_image(message)
    K, P = message.k.copy(), message.p.copy()
    if context.carla_bridge and (K[2], K[5]) == (message.width / 2, message.height / 2):
        K[[2, 5]] -= _TO_PIXEL_CENTRE
        P[[2, 6]] -= _TO_PIXEL_CENTRE
    calibration = CameraCalibration(
        frame_id=_frame_id(message),
        width=message.width,
        height=message.height,
        distortion_model=message.distortion_model,
        D=message.d.tolist(),
        K=K.tolist(),
        R=message.r.tolist(),
        P=P.tolist(),
    )
    return _stamped(message, camera_from_calibration(calibration))


def _require_whole_image(message: Any) -> None:
    """Check for a full image. K describes the full sensor, and drivers differ in how they bin or cut images."""
    roi = message.roi
    if message.binning_x > 1 or message.binning_y > 1:
        raise DecodeError(f"binning {message.binning_x}x{message.binning_y}: expected the calibration of whole pixels")
    whole = (roi.width, roi.height) in ((0, 0), (message.width, message.height))
    if roi.x_offset or roi.y_offset or not whole:
        part = f"{roi.width}x{roi.height} at {roi.x_offset}, {roi.y_offset}"
        raise DecodeError(f"region of interest {part}: expected the whole image, {message.width}x{message.height}")


@dataclass(frozen=True)
class _PackedPoints:
    """A PointCloud2's points in the form that ``points.unpack_points`` needs."""

    point_stride: int
    fields: tuple[PackedElementField, ...]
    data: bytes


def _point_cloud(message: Any, context: Context) -> Stamped:
    require_count("points", message.width * message.height, context.limits)
    return _stamped(message, PointCloud(_frame_id(message), lambda: _points_m(message)))


@cdr.as_defined("points as the log defines them")
def _points_m(message: Any) -> Float32:
    if message.is_bigendian:
        raise DecodeError("points in big-endian numbers: expected little-endian ones")
    used, found = message.point_step * message.width, len(message.data)
    if message.row_step < used or found < message.row_step * message.height:
        size = f"{message.height} rows of {message.width} x {message.point_step} bytes with row step {message.row_step}"
        raise DecodeError(f"{size}: expected {max(message.row_step, used) * message.height} bytes, found {found}")
    rows = message.data[: message.row_step * message.height].reshape(message.height, message.row_step)
    fields = tuple(
        PackedElementField(name=field.name, offset=field.offset, type=_FOXGLOVE_TYPES.get(field.datatype, 0))  # type: ignore[arg-type]
        for field in message.fields
    )
    return points.unpack_points(_PackedPoints(message.point_step, fields, rows[:, :used].tobytes()), np.eye(4))


def _detections(message: Any, context: Context) -> Stamped:
    require_count("detections", len(message.detections), context.limits)
    return _stamped(message, tuple(_detection(detection) for detection in message.detections))


def _detection(message: Any) -> Detection:
    """The hypothesis with the highest score. The fields' places differ between versions of vision_msgs."""
    hypotheses = [getattr(result, "hypothesis", result) for result in message.results]
    best = max(hypotheses, key=lambda hypothesis: hypothesis.score, default=None)
    label = "" if best is None else str(getattr(best, "class_id", None) or getattr(best, "id", ""))
    score = 0.0 if best is None else float(best.score)
    identity = str(getattr(message, "id", "") or getattr(message, "tracking_id", ""))
    box = _box(message.bbox)
    require_finite(f"detection {label!r}", box.x_min, box.y_min, box.x_max, box.y_max, score)
    return Detection(label, box, score, identity)


def _box(message: Any) -> Box:
    """The axis-aligned box around a rotated one."""
    centre = getattr(message.center, "position", message.center)
    c, s = abs(cos(message.center.theta)), abs(sin(message.center.theta))
    half_x = (message.size_x * c + message.size_y * s) / 2
    half_y = (message.size_x * s + message.size_y * c) / 2
    return Box(centre.x - half_x, centre.y - half_y, centre.x + half_x, centre.y + half_y)


def _transforms(message: Any, _: Context) -> Stamped:
    """The first transform's stamp is the message's."""
    edges = tuple(
        Transform(_frame_id(t), str(t.child_frame_id), pose_matrix(t.transform.translation, t.transform.rotation))
        for t in message.transforms
    )
    return Stamped(cdr.stamp_ns(message.transforms[0].header.stamp) if edges else 0, edges)


def _odometry(message: Any, _: Context) -> Stamped:
    """The pose of the message's child frame; without one, of the ego frame."""
    return _pose_of(message, message.pose.pose, str(message.child_frame_id) or EGO)


def _pose_of(message: Any, pose: Any, child: str) -> Stamped:
    matrix = pose_matrix(pose.position, pose.orientation)
    return _stamped(message, Transform(_frame_id(message), child, matrix))


def unpack_image(data: bytes) -> ros2.RosImage:
    """An image written by this package, of any encoding that ``Raster`` supports.

    Raises:
        DecodeError: the bytes are not such an image.
    """
    message = cdr.read(data, ros2.IMAGE, ros2.IMAGE_DEFINITION)
    pixels = Raster.of_ros(message).pixels()
    return ros2.RosImage(cdr.stamp_ns(message.header.stamp), message.header.frame_id, message.encoding, pixels)


_COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
DECODERS: Final[Mapping[tuple[Kind, str], Decoder]] = {
    **{(kind, ros2.IMAGE): _raw(kind) for kind in pictures.RASTER_KINDS},
    **{(kind, _COMPRESSED): _file(kind) for kind in pictures.FILE_KINDS},
    ("image", _COMPRESSED): _compressed_image,
    ("depth", _COMPRESSED): _compressed_depth,
    ("video", "foxglove_msgs/msg/CompressedVideo"): _video,
    ("video", _COMPRESSED): _video,
    ("points", "sensor_msgs/msg/PointCloud2"): _point_cloud,
    ("calibration", "sensor_msgs/msg/CameraInfo"): _calibration,
    ("detections", "vision_msgs/msg/Detection2DArray"): _detections,
    ("tf", "tf2_msgs/msg/TFMessage"): _transforms,
    ("pose", "nav_msgs/msg/Odometry"): _odometry,
    ("pose", "geometry_msgs/msg/PoseStamped"): lambda message, _: _pose_of(message, message.pose, EGO),
}
"""Decoder by kind and message type."""
