"""Decodes Foxglove messages, from protobuf or from JSON by way of the protobuf message."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as PointCloudProto
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from roadperc_stream.formats import points
from roadperc_stream.formats.raster import Raster
from roadperc_stream.geometry import Float32
from roadperc_stream.input.decoding import pictures
from roadperc_stream.input.decoding.payload import Context, Stamped, camera_from_calibration, pose_matrix, require_count
from roadperc_stream.model import EGO, PointCloud, Transform, VideoFrame
from roadperc_stream.schemas.protobuf import stamp_ns
from roadperc_stream.schemas.roles import Kind

Decoder = Callable[[Any, Context], Stamped]


def _file(kind: Kind) -> Decoder:
    """A decoder of messages that contain an image file."""

    def decoded(message: Any, context: Context) -> Stamped:
        pictures.require_picture(message.format)
        return _stamped(message, pictures.of_file(kind, message.frame_id, message.data, context))

    return decoded


def _raw(kind: Kind) -> Decoder:
    """A decoder of messages that contain raw pixels."""

    def decoded(message: Any, context: Context) -> Stamped:
        raster = Raster(message.encoding, message.width, message.height, message.step, message.data)
        return _stamped(message, pictures.of_raster(kind, message.frame_id, raster, context))

    return decoded


def _stamped(message: Any, payload: Any) -> Stamped:
    return Stamped(stamp_ns(message.timestamp), payload)


def _point_cloud(message: Any, context: Context) -> Stamped:
    require_count("points", len(message.data) // max(message.point_stride, 1), context.limits)
    return _stamped(message, PointCloud(message.frame_id, lambda: _points_m(message)))


def _points_m(message: Any) -> Float32:
    """Points in the frame of the message, transformed by its pose if it has one."""
    stated = message.HasField("pose")
    return points.unpack_points(
        message, pose_matrix(message.pose.position, message.pose.orientation) if stated else np.eye(4)
    )


def _transforms(message: Any, _: Context) -> Stamped:
    """The first transform's stamp is the message's."""
    edges = tuple(_edge(transform) for transform in message.transforms)
    stamp = stamp_ns(message.transforms[0].timestamp) if edges else 0
    return Stamped(stamp, edges)


def _edge(message: Any) -> Transform:
    matrix = pose_matrix(message.translation, message.rotation)
    return Transform(message.parent_frame_id, message.child_frame_id, matrix)


def _pose(message: Any, _: Context) -> Stamped:
    """A pose of the ego frame."""
    matrix = pose_matrix(message.pose.position, message.pose.orientation)
    return _stamped(message, Transform(message.frame_id, EGO, matrix))


def _video(message: Any, _: Context) -> Stamped:
    return _stamped(message, VideoFrame(message.frame_id, message.format, message.data))


DECODERS: Final[Mapping[tuple[Kind, Any], Decoder]] = {
    **{(kind, CompressedImage): _file(kind) for kind in pictures.FILE_KINDS},
    **{(kind, RawImage): _raw(kind) for kind in pictures.RASTER_KINDS},
    ("video", CompressedVideo): _video,
    ("video", CompressedImage): _video,
    ("points", PointCloudProto): _point_cloud,
    ("calibration", CameraCalibration): lambda message, _: _stamped(message, camera_from_calibration(message)),
    ("tf", FrameTransforms): _transforms,
    ("tf", FrameTransform): lambda message, _: _stamped(message, (_edge(message),)),
    ("pose", PoseInFrame): _pose,
}
"""Decoder by kind and message type."""
