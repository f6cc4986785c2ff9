"""The contents of Foxglove messages, parsed from protobuf, or from JSON by way of the protobuf message."""

from collections.abc import Mapping
from typing import Any, Final

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as PointCloudProto
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from roadperc_stream.formats import points
from roadperc_stream.geometry import Float32
from roadperc_stream.input.decoding import pictures
from roadperc_stream.input.decoding.payload import (
    Contents,
    Context,
    camera_from_calibration,
    pose_matrix,
    require_count,
)
from roadperc_stream.model import EGO, PointCloud, Transform
from roadperc_stream.schemas.roles import Kind

_NUMBERS: Final[Mapping[int, str]] = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<f4", 8: "<f8"}
"""numpy's names of foxglove.PackedElementField.NumericType, all little-endian."""


def _point_cloud(message: Any, context: Context) -> PointCloud:
    require_count("points", len(message.data) // max(message.point_stride, 1), context.limits)
    return PointCloud(message.frame_id, lambda: _points_m(message))


def _points_m(message: Any) -> Float32:
    """Points in the frame of the message, transformed by its pose if it has one."""
    pose = pose_matrix(message.pose.position, message.pose.orientation) if message.HasField("pose") else None
    fields = {field.name: (field.offset, _NUMBERS.get(field.type, "")) for field in message.fields}
    return points.unpack_points(message.data, message.point_stride, fields, pose)


def _edge(message: Any) -> Transform:
    matrix = pose_matrix(message.translation, message.rotation)
    return Transform(message.parent_frame_id, message.child_frame_id, matrix)


def _pose(message: Any, _: Context) -> Transform:
    """A pose of the ego frame."""
    return Transform(message.frame_id, EGO, pose_matrix(message.pose.position, message.pose.orientation))


CONTENTS: Final[Mapping[tuple[Kind, Any], Contents]] = {
    **{(kind, CompressedImage): pictures.file(kind) for kind in pictures.FILE_KINDS},
    **{(kind, RawImage): pictures.raw(kind) for kind in pictures.RASTER_KINDS},
    ("video", CompressedVideo): pictures.video,
    ("video", CompressedImage): pictures.video,
    ("points", PointCloudProto): _point_cloud,
    ("calibration", CameraCalibration): lambda message, _: camera_from_calibration(message),
    ("tf", FrameTransforms): lambda message, _: tuple(map(_edge, message.transforms)),
    ("tf", FrameTransform): lambda message, _: (_edge(message),),
    ("pose", PoseInFrame): _pose,
}
"""By kind and message type."""
