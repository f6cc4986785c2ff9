"""What a frame's results look like in the log: topics and bytes."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace

import numpy as np

from roadperc_stream import drawing, encoding, images
from roadperc_stream.datatypes import Absent, FrameResult, Mask, Odometry, Sample
from roadperc_stream.decoding import Transform
from roadperc_stream.geometry import Float
from roadperc_stream.rows import FrameMetrics
from roadperc_stream.schemas import roadperc_pb2 as pb
from roadperc_stream.schemas.protobuf import set_stamp
from roadperc_stream.schemas.ros2 import LAST_STAMP_NS
from roadperc_stream.semantics import Colour

DRIVABLE_COLOURS: tuple[Colour, Colour] = ((0, 0, 0), (0, 200, 80))
ODOM, EGO = "odom", "ego"
_BEYOND_ROS_2 = f"the frame's stamp is beyond {LAST_STAMP_NS} ns (2038-01-19), the last one ROS 2 messages hold"
Written = Iterator[tuple[str, bytes]]


def result_messages(
    sample: Sample,
    result: FrameResult,
    metrics: FrameMetrics,
    previous_reasons: tuple[str, ...],
    trajectory: Sequence[Float],
) -> Written:
    """Topic and bytes of everything a frame gave; what is absent is not written.

    Args:
        sample: the frame's input.
        result: what the chain made of it.
        metrics: its row.
        previous_reasons: reasons of the frame before: only new ones are logged, not one line per frame.
        trajectory: the latest poses odom_T_ego that are known, this frame's last.
    """
    stamp_ns = result.stamp_ns
    yield from _surface(sample, result)
    yield from _lanes_and_objects(sample, result)
    if not isinstance(result.stereo, Absent):
        depth = encoding.encode_depth(stamp_ns, result.stereo.frame_id, result.stereo.depth_m)
        yield "/perception/stereo/depth", depth
    if not isinstance(result.occupancy, Absent):
        yield "/perception/occupancy", encoding.encode_occupancy(stamp_ns, result.occupancy)
    if not isinstance(result.odometry, Absent):
        yield from _odometry(stamp_ns, result.odometry, trajectory)
    yield "/perception/metrics", encode_metrics(sample.frame.camera.frame_id, metrics)
    for reason in metrics.reasons:
        if reason not in previous_reasons:
            yield "/perception/log", encoding.encode_log(stamp_ns, "WARNING", f"frame {sample.index}: {reason}")


def as_written(result: FrameResult) -> tuple[FrameResult, FrameResult]:
    """A frame's result, and what of it the log can carry: ROS 2 messages end in 2038, all others go on.

    The metrics are those of the whole result, which says what is not written.
    """
    if result.stamp_ns <= LAST_STAMP_NS:
        return result, result
    outputs = {"stereo": result.stereo, "occupancy": result.occupancy}
    left_out = [name for name, output in outputs.items() if not isinstance(output, Absent)]
    reasons = (f"{name}: not written, {_BEYOND_ROS_2}" for name in left_out)
    result = replace(result, problems=(*result.problems, *reasons))
    return result, replace(result, stereo=Absent(_BEYOND_ROS_2), occupancy=Absent(_BEYOND_ROS_2))


def _surface(sample: Sample, result: FrameResult) -> Written:
    stamp_ns, frame = result.stamp_ns, sample.frame
    if not isinstance(result.surface, Absent):
        yield "/perception/surface", encoding.encode_surface(stamp_ns, result.surface)
    if not isinstance(result.drivable, Absent):
        yield "/perception/drivable", _drivable(stamp_ns, frame.camera.frame_id, result.drivable)
        if not isinstance(result.front_surface, Absent):
            scene = drawing.drivable_scene(
                stamp_ns, result.front_surface, frame.camera, frame.ego_T_camera, result.drivable
            )
            yield "/perception/drivable/scene", scene


def _lanes_and_objects(sample: Sample, result: FrameResult) -> Written:
    stamp_ns, camera = result.stamp_ns, sample.frame.camera
    if not isinstance(result.lanes, Absent):
        yield "/perception/lanes", encoding.encode_lanes(stamp_ns, camera.frame_id, result.lanes)
        yield "/perception/lanes/annotations", drawing.lane_annotations(stamp_ns, camera, result.lanes)
        yield "/perception/lanes/scene", drawing.lanes_scene(stamp_ns, result.lanes)
    if not isinstance(result.objects, Absent):
        yield "/perception/objects", encoding.encode_objects(stamp_ns, camera.frame_id, result.objects)
        yield "/perception/objects/annotations", drawing.object_annotations(stamp_ns, camera, result.objects)


def _odometry(stamp_ns: int, odometry: Odometry, trajectory: Sequence[Float]) -> Written:
    """Of a lost frame the state alone says where the car was last: as a pose of this frame it would be false."""
    yield "/perception/odometry/state", encoding.encode_odometry(stamp_ns, EGO, odometry)
    yield "/perception/trajectory", encoding.encode_poses(stamp_ns, ODOM, trajectory)
    if odometry.status != "lost":
        yield "/perception/odometry", encoding.encode_pose(stamp_ns, ODOM, odometry.odom_T_ego)
        edge = Transform(ODOM, EGO, odometry.odom_T_ego)
        yield "/perception/tf", encoding.encode_transforms(stamp_ns, [edge])


def encode_metrics(frame_id: str, metrics: FrameMetrics) -> bytes:
    """roadperc.FrameMetrics: the row, unknown fields absent."""
    known = {name: value for name, value in asdict(metrics).items() if value is not None}
    message = pb.FrameMetrics(frame_id=frame_id, **known)
    set_stamp(message, metrics.stamp_ns)
    return message.SerializeToString()


def _drivable(stamp_ns: int, frame_id: str, mask: Mask) -> bytes:
    data = images.encode_indices(mask.view(np.uint8), DRIVABLE_COLOURS)
    return encoding.encode_image(stamp_ns, frame_id, "png", data)
