"""Foxglove's well-known messages: as protobuf, and as JSON, which is read into the protobuf message first."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as PointCloudProto
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from roadperc_stream.core.datatypes import EGO, PointCloud, Transform
from roadperc_stream.core.geometry import Float32
from roadperc_stream.formats import points
from roadperc_stream.formats.raster import Content, Raster
from roadperc_stream.input.decoding import pictures
from roadperc_stream.input.decoding.bounds import require_count
from roadperc_stream.input.decoding.calibration import camera_from_calibration
from roadperc_stream.input.decoding.payload import Context, Decoded, pose_matrix
from roadperc_stream.schemas.protobuf import stamp_ns
from roadperc_stream.schemas.roles import Kind


def _compressed_image(message: Any, data: Content, context: Context) -> Decoded:
    image = pictures.encoded_image(message.frame_id, data, context.limits)
    return Decoded(stamp_ns(message.timestamp), image)


def _compressed_tags(message: Any, data: Content, context: Context) -> Decoded:
    tags = pictures.encoded_tags(message.frame_id, data, context)
    return Decoded(stamp_ns(message.timestamp), tags)


def _raw_image(message: Any, data: Content, context: Context) -> Decoded:
    image = pictures.raw_image(message.frame_id, _raster(message, data), context.limits)
    return Decoded(stamp_ns(message.timestamp), image)


def _raw_depth(message: Any, data: Content, context: Context) -> Decoded:
    depth = pictures.raw_depth(message.frame_id, _raster(message, data), context.limits)
    return Decoded(stamp_ns(message.timestamp), depth)


def _raw_tags(message: Any, data: Content, context: Context) -> Decoded:
    tags = pictures.raw_tags(message.frame_id, _raster(message, data), context)
    return Decoded(stamp_ns(message.timestamp), tags)


def _compressed_instances(message: Any, data: Content, context: Context) -> Decoded:
    instances = pictures.encoded_instances(message.frame_id, data, context.limits)
    return Decoded(stamp_ns(message.timestamp), instances)


def _raw_instances(message: Any, data: Content, context: Context) -> Decoded:
    instances = pictures.raw_instances(message.frame_id, _raster(message, data), context.limits)
    return Decoded(stamp_ns(message.timestamp), instances)


def _raster(message: Any, data: Content) -> Raster:
    return Raster(message.encoding, message.width, message.height, message.step, data)


def _point_cloud(message: Any, context: Context) -> Decoded:
    require_count("points", len(message.data) // max(message.point_stride, 1), context.limits)
    return Decoded(stamp_ns(message.timestamp), PointCloud(message.frame_id, lambda: _points_m(message)))


def _points_m(message: Any) -> Float32:
    """Points in the frame the message names: its pose, where it states one, places them there."""
    stated = message.HasField("pose")
    return points.unpack_points(
        message, pose_matrix(message.pose.position, message.pose.orientation) if stated else np.eye(4)
    )


def _calibration(message: Any, _: Context) -> Decoded:
    return Decoded(stamp_ns(message.timestamp), camera_from_calibration(message))


def _transform(message: Any, _: Context) -> Decoded:
    return Decoded(stamp_ns(message.timestamp), (_edge(message),))


def _transforms(message: Any, context: Context) -> Decoded:
    """The first transform's stamp is the message's."""
    require_count("transforms", len(message.transforms), context.limits)
    edges = tuple(_edge(transform) for transform in message.transforms)
    stamp = stamp_ns(message.transforms[0].timestamp) if edges else 0
    return Decoded(stamp, edges)


def _edge(message: Any) -> Transform:
    matrix = pose_matrix(message.translation, message.rotation)
    return Transform(message.parent_frame_id, message.child_frame_id, matrix)


def _pose(message: Any, _: Context) -> Decoded:
    """A pose of the ego frame."""
    matrix = pose_matrix(message.pose.position, message.pose.orientation)
    return Decoded(stamp_ns(message.timestamp), Transform(message.frame_id, EGO, matrix))


PICTURES: Final[Mapping[tuple[Kind, Any], Callable[[Any, Content, Context], Decoded]]] = {
    ("image", CompressedImage): _compressed_image,
    ("image", RawImage): _raw_image,
    ("tags", CompressedImage): _compressed_tags,
    ("tags", RawImage): _raw_tags,
    ("instances", CompressedImage): _compressed_instances,
    ("instances", RawImage): _raw_instances,
    ("depth", RawImage): _raw_depth,
}
"""By kind and type of message, of which field ``data`` is given apart."""
DECODERS: Final[Mapping[tuple[Kind, Any], Callable[[Any, Context], Decoded]]] = {
    ("points", PointCloudProto): _point_cloud,
    ("calibration", CameraCalibration): _calibration,
    ("tf", FrameTransforms): _transforms,
    ("tf", FrameTransform): _transform,
    ("pose", PoseInFrame): _pose,
}
"""By kind and type of message."""
