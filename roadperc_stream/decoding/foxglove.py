"""Foxglove's well-known messages as protobuf."""

from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as PointCloudProto
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from roadperc_stream import images, points
from roadperc_stream.datatypes import CameraImage, PointCloud, TagImage
from roadperc_stream.decoding.calibration import camera_from_calibration
from roadperc_stream.decoding.payload import Context, Decoded, Transform, pose_matrix
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Float32
from roadperc_stream.schemas.protobuf import stamp_ns


def image(data: bytes, _: Context) -> Decoded:
    """foxglove.CompressedImage of a camera."""
    message = CompressedImage.FromString(data)
    content = message.data
    decoded = CameraImage(message.frame_id, lambda: images.decode_bgr(content), lambda: images.decode_grey(content))
    return Decoded(stamp_ns(message.timestamp), decoded)


def tags(data: bytes, context: Context) -> Decoded:
    """foxglove.CompressedImage whose palette indices are tags."""
    message = CompressedImage.FromString(data)
    content = message.data
    if context.tag_table is None:
        raise DecodeError("the log does not say its tag table; set tag_table, such as --set tag_table=0.9.15")
    return Decoded(
        stamp_ns(message.timestamp),
        TagImage(message.frame_id, context.tag_table, lambda: images.decode_indices(content)),
    )


def point_cloud(data: bytes, _: Context) -> Decoded:
    """foxglove.PointCloud."""
    message = PointCloudProto.FromString(data)
    return Decoded(stamp_ns(message.timestamp), PointCloud(message.frame_id, lambda: _points_m(message)))


def _points_m(message: Any) -> Float32:
    """Points in the frame the message names: its pose, where it states one, places them there."""
    stated = message.HasField("pose")
    return points.unpack_points(
        message, pose_matrix(message.pose.position, message.pose.orientation) if stated else np.eye(4)
    )


def calibration(data: bytes, _: Context) -> Decoded:
    """foxglove.CameraCalibration."""
    message = CameraCalibration.FromString(data)
    return Decoded(stamp_ns(message.timestamp), camera_from_calibration(message))


def transforms(data: bytes, _: Context) -> Decoded:
    """foxglove.FrameTransforms; the first one's stamp is the message's."""
    message = FrameTransforms.FromString(data)
    edges = tuple(
        Transform(t.parent_frame_id, t.child_frame_id, pose_matrix(t.translation, t.rotation))
        for t in message.transforms
    )
    stamp = stamp_ns(message.transforms[0].timestamp) if edges else 0
    return Decoded(stamp, edges)


def pose(data: bytes, _: Context) -> Decoded:
    """foxglove.PoseInFrame of the ego frame."""
    message = PoseInFrame.FromString(data)
    matrix = pose_matrix(message.pose.position, message.pose.orientation)
    return Decoded(stamp_ns(message.timestamp), Transform(message.frame_id, "ego", matrix))
