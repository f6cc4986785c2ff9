"""Encodes data types as messages, for ``roadperc-convert`` and the replay."""

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, Final

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame

from roadperc_stream.formats.images import depth_to_mm
from roadperc_stream.formats.points import FIELDS
from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.geometry.rectification import lens_of
from roadperc_stream.geometry.rotations import quaternion
from roadperc_stream.model import Boundary, Detection, HeightGrid, Lanes, Object, Objects, Odometry, Surface, Transform
from roadperc_stream.schemas import roadperc_pb2 as pb
from roadperc_stream.schemas.protobuf import set_stamp
from roadperc_stream.schemas.ros2 import RosImage, pack_image

_KEPT_POSES: Final = 1024
"""Enough for some trajectories. All frames of a window contain the same poses, so each is encoded once."""


def encode_image(stamp_ns: int, frame_id: str, image_format: str, data: bytes) -> bytes:
    """foxglove.CompressedImage of encoded bytes, ``png`` or ``jpeg``."""
    message = CompressedImage(frame_id=frame_id, format=image_format, data=data)
    return _serialised(message, stamp_ns)


def encode_depth(stamp_ns: int, frame_id: str, depth_m: Float32, *, as_float: bool = False) -> bytes:
    """sensor_msgs/msg/Image of (H, W) metres: 16UC1 millimetres, or 32FC1 metres with NaN unknown."""
    if as_float:
        return pack_image(RosImage(stamp_ns, frame_id, "32FC1", np.ascontiguousarray(depth_m, np.float32)))
    return pack_image(RosImage(stamp_ns, frame_id, "16UC1", depth_to_mm(depth_m)))


def encode_calibration(stamp_ns: int, camera: Camera) -> bytes:
    """foxglove.CameraCalibration; P of a right camera contains -fx * baseline."""
    lens = camera.lens
    P = np.zeros((3, 4))
    P[:, :3] = camera.K
    P[0, 3] = -camera.fx * (camera.baseline_m or 0.0)
    message = CameraCalibration(
        frame_id=camera.frame_id,
        width=camera.width,
        height=camera.height,
        distortion_model=lens.model if lens else ("plumb_bob" if camera.distortion else ""),
        D=camera.distortion,
        K=(lens.K if lens else camera.K).ravel().tolist(),
        R=lens_of(camera).R,
        P=P.ravel().tolist(),
    )
    return _serialised(message, stamp_ns)


def encode_transforms(stamp_ns: int, transforms: Iterable[Transform]) -> bytes:
    """foxglove.FrameTransforms of edges parent_T_child."""
    message = FrameTransforms()
    for edge in transforms:
        entry = message.transforms.add(parent_frame_id=edge.parent, child_frame_id=edge.child)
        set_stamp(entry, stamp_ns)
        _set_vector(entry.translation, edge.parent_T_child[:3, 3])
        _set_quaternion(entry.rotation, edge.parent_T_child)
    return message.SerializeToString()


def encode_pose(stamp_ns: int, frame_id: str, frame_T_body: Float) -> bytes:
    """foxglove.PoseInFrame of a (4, 4) transform."""
    return _serialised(PoseInFrame(frame_id=frame_id, pose=_posed(Pose(), frame_T_body)), stamp_ns)


def encode_poses(stamp_ns: int, frame_id: str, frame_T_body: Iterable[Float]) -> bytes:
    """foxglove.PosesInFrame of (4, 4) transforms, in order."""
    poses = [_listed_pose(matrix.tobytes()) for matrix in frame_T_body]
    return _serialised(PosesInFrame(frame_id=frame_id, poses=poses), stamp_ns)


@lru_cache(_KEPT_POSES)
def _listed_pose(matrix: bytes) -> Any:
    """foxglove.Pose of the bytes of a (4, 4) float64 transform."""
    return _posed(Pose(), np.frombuffer(matrix).reshape(4, 4))


def encode_odometry(stamp_ns: int, frame_id: str, odometry: Odometry) -> bytes:
    """roadperc.Odometry."""
    message = pb.Odometry(
        frame_id=frame_id,
        odom_T_ego=_posed(pb.Pose(), odometry.odom_T_ego),
        step=None if odometry.step is None else _posed(pb.Pose(), odometry.step),
        status=pb.Odometry.Status.Value(odometry.status.upper()),
        up_to_scale=odometry.up_to_scale,
        inliers=odometry.inliers,
        covariance=odometry.covariance,
        reason=None if odometry.reason is None else pb.Reason(**odometry.reason.stored),
    )
    return _serialised(message, stamp_ns)


def encode_detections(stamp_ns: int, frame_id: str, detections: Iterable[Detection]) -> bytes:
    """roadperc.Detections."""
    message = pb.Detections(frame_id=frame_id, detections=[_detection(d) for d in detections])
    return _serialised(message, stamp_ns)


def encode_surface(stamp_ns: int, surface: Surface) -> bytes:
    """roadperc.Surface."""
    a, b, d = surface.abd
    x, y, z = surface.plane.normal
    message = pb.Surface(
        frame_id=surface.frame_id,
        model=surface.model,
        source=surface.source,
        normal=pb.Vector3(x=x, y=y, z=z),
        camera_height_m=surface.camera_height_m,
        pitch=surface.pitch,
        roll=surface.roll,
        inlier_ratio=surface.inlier_ratio,
        a=a,
        b=b,
        d=d,
        height_grid=None if surface.height_grid is None else _height_grid(surface.height_grid),
    )
    return _serialised(message, stamp_ns)


def encode_lanes(stamp_ns: int, frame_id: str, lanes: Lanes) -> bytes:
    """roadperc.Lanes."""
    message = pb.Lanes(
        frame_id=frame_id,
        boundaries=[_boundary(b) for b in lanes.boundaries],
        proposals_px=[_line(row) for row in lanes.proposals_px.tolist()],
        merged_px=[_line(row) for row in lanes.merged_px.tolist()],
        lane_change=lanes.lane_change or "",
        lane_changes=lanes.lane_changes,
    )
    return _serialised(message, stamp_ns)


def encode_objects(stamp_ns: int, frame_id: str, objects: Objects) -> bytes:
    """roadperc.Objects."""
    message = pb.Objects(frame_id=frame_id, objects=[_object(o) for o in objects.objects])
    return _serialised(message, stamp_ns)


def encode_warning(stamp_ns: int, text: str) -> bytes:
    """foxglove.Log with the name ``roadperc`` and level ``WARNING``."""
    return _serialised(Log(level=Log.WARNING, message=text, name="roadperc"), stamp_ns)


def _serialised(message: Any, stamp_ns: int) -> bytes:
    """The bytes of a message with its stamp."""
    set_stamp(message, stamp_ns)
    data: bytes = message.SerializeToString()
    return data


def _detection(detection: Detection) -> Any:
    return vars(detection) | {"box_px": vars(detection.box_px)}


def _height_grid(grid: HeightGrid) -> pb.HeightGrid:
    rows, columns = grid.z_m.shape
    return pb.HeightGrid(**vars(grid) | {"rows": rows, "columns": columns, "z_m": grid.z_m.ravel().tolist()})


def _line(line: Iterable[float]) -> Any:
    return dict(zip(("x1", "y1", "x2", "y2"), line, strict=True))


def _boundary(boundary: Boundary) -> Any:
    """Fields have the same names in the message; ``converted`` are those of other types."""
    converted = {
        "side": pb.Boundary.Side.Value(boundary.side.upper()),
        "status": pb.Boundary.Status.Value(boundary.status.upper()),
        "raw_px": None if boundary.raw_px is None else _line(boundary.raw_px),
        "smoothed_px": None if boundary.smoothed_px is None else _line(boundary.smoothed_px),
        "line_ego_m": [{"x": x, "y": y, "z": z} for x, y, z in boundary.line_ego_m.tolist()],
        "line_px": [{"x": x, "y": y} for x, y in boundary.line_px.tolist()],
        "reason": None if boundary.reason is None else pb.Reason(**boundary.reason.stored),
    }
    return vars(boundary) | converted


def _object(item: Object) -> Any:
    """Fields of the message; ``depth`` is an empty source, as in logs before there was another one."""
    converted = {
        "detection": _detection(item.detection),
        "status": pb.Object.Status.Value(item.status.upper()),
        "distance_source": item.distance_source if item.distance_source != "depth" else "",
    }
    return vars(item) | converted


def _posed(pose: Any, transform: Float) -> Any:
    """A pose message, filled with a (4, 4) transform."""
    _set_vector(pose.position, transform[:3, 3])
    _set_quaternion(pose.orientation, transform)
    return pose


def _set_vector(vector: Any, values: Float) -> None:
    vector.x, vector.y, vector.z = (float(v) for v in values)


def _set_quaternion(target: Any, transform: Float) -> None:
    target.x, target.y, target.z, target.w = quaternion(transform[:3, :3])


def encode_points(stamp_ns: int, frame_id: str, points: Float32) -> bytes:
    """foxglove.PointCloud of (N, 3) x, y, z in metres, or (N, 4) with intensities."""
    columns = points.shape[1]
    message = PointCloud(
        frame_id=frame_id,
        point_stride=4 * columns,
        fields=[
            PackedElementField(name=name, offset=4 * k, type=PackedElementField.FLOAT32)
            for k, name in enumerate(FIELDS[:columns])
        ],
        data=np.ascontiguousarray(points, "<f4").tobytes(),
    )
    message.pose.orientation.w = 1.0
    return _serialised(message, stamp_ns)
