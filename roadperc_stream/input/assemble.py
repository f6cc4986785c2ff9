"""Builds samples from synchronised messages: camera, mounting, and missing roles."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final, TypeVar
from zlib import crc32

import numpy as np

from roadperc_stream import model
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import WITHOUT_CALIBRATION, ChannelError
from roadperc_stream.geometry import Camera, Float, inverse, mounting
from roadperc_stream.input.calibrations import calibration_role, own_calibration
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.rectified import rectified_frame, rectified_truth
from roadperc_stream.input.sync import Paired, reference_of, skew_ns
from roadperc_stream.input.transforms import NOTHING_LATCHED, LatchedState, TransformTree
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES

EGO_FRAMES: Final = (model.EGO, "base_footprint", "base_link", "ego_vehicle", "hero")
"""Names of the vehicle's frame in logs (REP 105, REP 120, CARLA); the frame on the road comes first."""
_SAME_PLACE: Final = 1e-6
"""Tolerance in metres and radians for two cameras in the same place."""
T = TypeVar("T")


def sample_of(
    cfg: ReplayConfig,
    paired: Paired,
    index: int,
    topics: Mapping[str, str],
    parent_of: Mapping[str, str],
    given: LatchedState = NOTHING_LATCHED,
) -> model.Sample:
    """The sample of one instant's messages.

    ``cfg`` gives the assumed height of a camera without a mounting. ``index`` is the number of the frame in the replay,
    from 0, or ``UNWRITTEN`` for a warm-up frame. ``parent_of`` has each frame that the log places at any time. The
    ``given`` cameras and mountings replaced those of the log in ``paired``.

    Raises:
        ChannelError: a camera without calibration; the message names it.
    """
    reference = reference_of(paired)
    messages, latched, tree = paired, reference.latched, reference.latched.tree
    depth = _payload(messages, "depth", model.DepthImage)
    camera = _camera(reference, topics)
    depth_camera = _depth_camera(latched, camera, depth)
    mounted = given.tree.edges.get(camera.frame_id)
    known = ego_T_camera_of(tree, camera) if mounted is None else mounted.parent_T_child
    ego_T_camera = mounting(z=cfg.surface.assumed_height_m) if known is None else known
    left_camera = _left_camera(reference, camera, topics)
    is_pair = "left" in topics and reference.role != "left"
    left = _payload(messages, "left", model.CameraImage) if is_pair else None
    points = _payload(messages, "lidar", model.PointCloud)
    detections = messages.get("detections")
    pose = _payload(messages, "truth_pose", model.Transform)
    frame = model.Frame(
        stamp_ns=reference.stamp_ns,
        camera=camera,
        ego_T_camera=ego_T_camera,
        depth_camera=depth_camera,
        ego_T_depth_camera=_mounting(tree, ego_T_camera, camera, depth_camera),
        left_camera=left_camera,
        ego_T_left=_mounting(tree, ego_T_camera, camera, left_camera),
        mounted=known is not None,
        image=_payload(messages, "image", model.CameraImage) or _payload(messages, "left", model.CameraImage),
        left=left,
        right=_payload(messages, "right", model.CameraImage),
        right_camera=latched.cameras.get("right_calibration"),
        depth_image=depth,
        segmentation=_payload(messages, "segmentation", model.TagImage),
        instance_image=_payload(messages, "instances", model.InstanceImage),
        detections=detections.payload if detections else None,  # type: ignore[arg-type]
        points=points,
        ego_T_lidar=None if points is None else lidar_mounting(tree, ego_T_camera, camera, points.frame_id),
        is_origin=index == 0,
        number=None if index == model.UNWRITTEN else index,
        pose_mark=None if pose is None else crc32(pose.parent_T_child.tobytes()),
    )
    missing = tuple(role for role in topics if _expected(role) and role not in messages)
    own = None if mounted is not None else _own_frame(tree, camera)
    truth, anchor = _truth(messages, tree, camera), _anchor(own, camera, ego_T_camera, parent_of)
    frame, truth = rectified_frame(frame), rectified_truth(truth, camera)
    return model.Sample(index, reference.log_time_ns, frame, truth, missing, skew_ns(paired), anchor, reference.segment)


def _expected(role: str) -> bool:
    return not ROLES[role].truth and ROLES[role].kind not in LATCHED_KINDS


def _payload(messages: Mapping[str, Stamped], role: str, kind: type[T]) -> T | None:
    message = messages.get(role)
    return message.payload if message is not None and isinstance(message.payload, kind) else None


def _camera(reference: Stamped, topics: Mapping[str, str]) -> Camera:
    """The camera of image, segmentation and detections."""
    role, wanted = reference.role, own_calibration(reference.role)
    camera = reference.latched.cameras.get(calibration_role(role, reference.latched.cameras))
    if camera is None:
        frame_id = getattr(reference.payload, "frame_id", "")
        raise ChannelError(
            f"{topics[role]}: camera {frame_id!r} has no calibration at {reference.stamp_ns} ns: expected "
            f"one on {ROLES[wanted].topic}, or --topic {wanted}=/TOPIC",
            WITHOUT_CALIBRATION,
            "for a log without one",
        )
    return camera


def _depth_camera(latched: LatchedState, camera: Camera, depth: model.DepthImage | None) -> Camera:
    """The depth calibration if the log has one; else the front camera's, with the depth's frame id."""
    own = latched.cameras.get("depth_calibration")
    if own is not None:
        return own
    if depth is None or depth.frame_id in ("", camera.frame_id):
        return camera
    return replace(camera, frame_id=depth.frame_id, baseline_m=None, distortion=(), lens=None)


def _left_camera(reference: Stamped, camera: Camera, topics: Mapping[str, str]) -> Camera:
    """The left camera of a stereo pair: a separate one if the log has it, else the front camera.

    A log may have a left calibration without left images. The baseline then does not hold for the front camera, so its
    image must not be matched.
    """
    if reference.role == "left":
        return camera
    own = reference.latched.cameras.get("left_calibration")
    if "left" not in topics:
        return camera if own is None or _is_front(reference.latched.tree, camera, own) else own
    if own is None:
        raise ChannelError(
            f"{topics['left']}: the left camera has no calibration at {reference.stamp_ns} ns: "
            "expected one in the log, or pass --calibration FILE with cameras.left"
        )
    return own


def _is_front(tree: TransformTree, camera: Camera, other: Camera) -> bool:
    """Whether another calibration describes the front camera: same view, same place."""
    if not camera.same_view(other):
        return False
    if other.frame_id in ("", camera.frame_id):
        return True
    camera_T_other = tree.lookup(camera.frame_id, other.frame_id)
    return camera_T_other is not None and np.allclose(camera_T_other, np.eye(4), atol=_SAME_PLACE)


def ego_T_camera_of(tree: TransformTree, camera: Camera) -> Float | None:
    """The camera's mounting; None without a transform, or if its frame is the vehicle's, not an optical one."""
    frame = ego_frame_of(tree, camera)
    return None if frame is None else tree.lookup(frame, camera.frame_id)


def ego_frame_of(tree: TransformTree, camera: Camera) -> str | None:
    """The name of the ego frame in a camera's transform tree; None if the camera has no mounting."""
    return None if camera.frame_id in EGO_FRAMES else _ego_frame(tree, camera.frame_id)


def _own_frame(tree: TransformTree, camera: Camera) -> str | None:
    """The log's ego frame, which may be the frame of its images."""
    return camera.frame_id if camera.frame_id in EGO_FRAMES else ego_frame_of(tree, camera)


def _anchor(own: str | None, camera: Camera, ego_T_camera: Float, parent_of: Mapping[str, str]) -> model.FrameAnchor:
    """The anchor at the log's ego frame ``own``; without one, at the camera with its assumed or given mounting."""
    frame_id, ego_T_frame = (camera.frame_id, ego_T_camera) if own is None else (own, np.eye(4))
    placed = frame_id in parent_of
    is_taken = placed or model.ODOM in parent_of or model.ODOM in parent_of.values()
    odom = model.OWN_ODOM if is_taken else model.ODOM
    return model.FrameAnchor("" if frame_id == model.EGO else frame_id, ego_T_frame, placed, odom)


def _ego_T(tree: TransformTree, frame_id: str, sensor: str = "") -> Float | None:
    """ego_T_frame; None if the tree does not connect the frame with ego."""
    frame = _ego_frame(tree, frame_id, sensor)
    return None if frame is None else tree.lookup(frame, frame_id)


def _ego_frame(tree: TransformTree, frame_id: str, sensor: str = "") -> str | None:
    """The first ego name that the tree connects with a frame; None without one.

    CARLA's bridge names a vehicle's frame by its role name and a sensor's frame ``role_name/sensor``. Pass a sensor's
    frame as ``sensor`` if ``frame_id`` is not one.
    """
    owner, separator, _ = (sensor or frame_id).partition("/")
    names = (*EGO_FRAMES, owner) if separator else EGO_FRAMES
    return next((name for name in names if tree.lookup(name, frame_id) is not None), None)


def _mounting(tree: TransformTree, ego_T_camera: Float, camera: Camera, other: Camera) -> Float:
    """ego_T_other by the transform tree; without a transform, the front camera's mounting."""
    camera_T_other = tree.lookup(camera.frame_id, other.frame_id)
    return ego_T_camera if camera_T_other is None else ego_T_camera @ camera_T_other


def lidar_mounting(tree: TransformTree, ego_T_camera: Float, camera: Camera, frame_id: str) -> Float | None:
    """ego_T_lidar by the transform tree, preferably through the camera; None without a transform.

    A lidar is never at the front camera's place, so none is assumed. Points in the camera's or ego's frame need no
    transform.
    """
    camera_T_lidar = tree.lookup(camera.frame_id, frame_id)
    return _ego_T(tree, frame_id) if camera_T_lidar is None else ego_T_camera @ camera_T_lidar


def _truth(messages: Mapping[str, Stamped], tree: TransformTree, camera: Camera) -> model.Truth:
    return model.Truth(
        odom_T_ego=_true_pose(_payload(messages, "truth_pose", model.Transform), tree, camera),
        surface=_payload(messages, "truth_surface", model.Surface),
        lanes=_payload(messages, "truth_lanes", model.Lanes),
        objects=_payload(messages, "truth_objects", model.Objects),
        depth=_payload(messages, "truth_depth", model.DepthImage),
        segmentation=_payload(messages, "truth_segmentation", model.TagImage),
    )


def _true_pose(pose: model.Transform | None, tree: TransformTree, camera: Camera) -> Float | None:
    """odom_T_ego of a pose of any vehicle frame; None if no transform connects that frame with ego."""
    ego_T_child = None if pose is None else _ego_T(tree, pose.child, camera.frame_id)
    return None if pose is None or ego_T_child is None else pose.parent_T_child @ inverse(ego_T_child)
