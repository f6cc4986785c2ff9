"""The contents of ROS 2 messages, parsed by the definition in their log."""

from collections.abc import Mapping
from math import cos, sin
from typing import Any, Final

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import points
from roadperc_stream.formats.raster import Raster
from roadperc_stream.geometry import Camera, Float32
from roadperc_stream.input.decoding import pictures
from roadperc_stream.input.decoding.payload import (
    Contents,
    Context,
    camera_from_calibration,
    frame_of,
    pose_matrix,
    require_count,
)
from roadperc_stream.model import EGO, Box, Detection, PointCloud, Transform
from roadperc_stream.schemas import cdr, ros2
from roadperc_stream.schemas.protobuf import require_finite
from roadperc_stream.schemas.roles import Kind

_NUMBERS: Final = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}
"""numpy's names of the types of sensor_msgs/msg/PointField."""
_TO_PIXEL_CENTRE: Final = 0.5


def _calibration(message: Any, context: Context) -> Camera:
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
        frame_id=frame_of(message),
        width=message.width,
        height=message.height,
        distortion_model=message.distortion_model,
        D=message.d.tolist(),
        K=K.tolist(),
        R=message.r.tolist(),
        P=P.tolist(),
    )
    return camera_from_calibration(calibration)


def _require_whole_image(message: Any) -> None:
    """Check for a full image. K describes the full sensor, and drivers differ in how they bin or cut images."""
    roi = message.roi
    if message.binning_x > 1 or message.binning_y > 1:
        raise DecodeError(f"binning {message.binning_x}x{message.binning_y}: expected the calibration of whole pixels")
    whole = (roi.width, roi.height) in ((0, 0), (message.width, message.height))
    if roi.x_offset or roi.y_offset or not whole:
        part = f"{roi.width}x{roi.height} at {roi.x_offset}, {roi.y_offset}"
        raise DecodeError(f"region of interest {part}: expected the whole image, {message.width}x{message.height}")


def _point_cloud(message: Any, context: Context) -> PointCloud:
    require_count("points", message.width * message.height, context.limits)
    return PointCloud(frame_of(message), lambda: _points_m(message))


@cdr.as_defined("points as the log defines them")
def _points_m(message: Any) -> Float32:
    if message.is_bigendian:
        raise DecodeError("points in big-endian numbers: expected little-endian ones")
    used, found = message.point_step * message.width, len(message.data)
    if message.row_step < used or found < message.row_step * message.height:
        size = f"{message.height} rows of {message.width} x {message.point_step} bytes with row step {message.row_step}"
        raise DecodeError(f"{size}: expected {max(message.row_step, used) * message.height} bytes, found {found}")
    rows = message.data[: message.row_step * message.height].reshape(message.height, message.row_step)
    fields = {field.name: (field.offset, _NUMBERS.get(field.datatype, "")) for field in message.fields}
    return points.unpack_points(rows[:, :used].tobytes(), message.point_step, fields)


def _detections(message: Any, context: Context) -> tuple[Detection, ...]:
    require_count("detections", len(message.detections), context.limits)
    return tuple(map(_detection, message.detections))


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


def _edge(message: Any) -> Transform:
    matrix = pose_matrix(message.transform.translation, message.transform.rotation)
    return Transform(frame_of(message), str(message.child_frame_id), matrix)


def _pose_of(message: Any, pose: Any, child: str) -> Transform:
    return Transform(frame_of(message), child, pose_matrix(pose.position, pose.orientation))


def unpack_image(data: bytes) -> ros2.RosImage:
    """An image written by this package, of any encoding that ``Raster`` supports.

    Raises:
        DecodeError: the bytes are not such an image.
    """
    message = cdr.read(data, ros2.IMAGE, ros2.IMAGE_DEFINITION)
    pixels = Raster.of(message).pixels()
    return ros2.RosImage(cdr.stamp_ns(message.header.stamp), message.header.frame_id, message.encoding, pixels)


_COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
CONTENTS: Final[Mapping[tuple[Kind, str], Contents]] = {
    **{(kind, ros2.IMAGE): pictures.raw(kind) for kind in pictures.RASTER_KINDS},
    **{(kind, _COMPRESSED): pictures.file(kind) for kind in pictures.FILE_KINDS},
    ("depth", _COMPRESSED): pictures.depth_file,
    ("video", "foxglove_msgs/msg/CompressedVideo"): pictures.video,
    ("video", _COMPRESSED): pictures.video,
    ("points", "sensor_msgs/msg/PointCloud2"): _point_cloud,
    ("calibration", "sensor_msgs/msg/CameraInfo"): _calibration,
    ("detections", "vision_msgs/msg/Detection2DArray"): _detections,
    ("tf", "tf2_msgs/msg/TFMessage"): lambda message, _: tuple(map(_edge, message.transforms)),
    ("pose", "nav_msgs/msg/Odometry"): lambda m, _: _pose_of(m, m.pose.pose, str(m.child_frame_id) or EGO),
    ("pose", "geometry_msgs/msg/PoseStamped"): lambda m, _: _pose_of(m, m.pose, EGO),
}
"""By kind and message type. The pose of an odometry is that of its child frame."""
