"""Encodes the results of a frame as topics and bytes."""

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any, Final

from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream.errors import DecodeError
from roadperc_stream.formats.png import encode_mask
from roadperc_stream.geometry import Float, inverse
from roadperc_stream.log import Channel
from roadperc_stream.model import EGO, Absent, FrameAnchor, FrameResult, Odometry, Reason, Sample, Transform
from roadperc_stream.model.sample import LAST_ROS_STAMP_NS
from roadperc_stream.model.tag_tables import Colour
from roadperc_stream.output import encoding
from roadperc_stream.output.drawing import annotations, colours
from roadperc_stream.schemas import row_messages, topics
from roadperc_stream.schemas.columns import FrameMetrics, cells
from roadperc_stream.schemas.protobuf import optional, reason_in, require_finite, schema, set_stamp
from roadperc_stream.schemas.record import PRODUCER
from roadperc_stream.schemas.ros2 import pack_occupancy_grid

DRIVABLE_COLOURS: tuple[Colour, Colour] = ((0, 0, 0), colours.DRIVABLE)
_COLUMNS: Final = {field.name for field in fields(FrameMetrics)}
_LISTS: Final = {field.name for field in fields(FrameMetrics) if field.default == ()}
_OPTIONAL: Final = {field.name for field in fields(FrameMetrics) if field.default is None}
Written = Iterator[tuple[str, bytes]]


def result_channel(topic: str, schema_name: str) -> Channel:
    """The channel of a result, marked as written by this project."""
    found = schema(schema_name)
    return Channel(topic, found.message_encoding, found.name, found.schema_encoding, found.data, (PRODUCER,))


def result_messages(
    sample: Sample,
    result: FrameResult,
    metrics: FrameMetrics,
    previous_reasons: tuple[Reason, ...],
    trajectory: Sequence[Float],
) -> Written:
    """Topic and bytes of each result of a frame; absent results are not written.

    Only reasons that are not in ``previous_reasons`` are logged. ``trajectory`` are the latest known poses odom_T_ego,
    this frame's last.
    """
    stamp_ns = result.stamp_ns
    yield from _surface(sample, result)
    yield from _lanes_and_objects(sample, result)
    is_ros_time = stamp_ns <= LAST_ROS_STAMP_NS
    if not isinstance(result.stereo, Absent) and is_ros_time:
        depth = encoding.encode_depth(stamp_ns, result.stereo.frame_id, result.stereo.depth_m)
        yield topics.STEREO_DEPTH_TOPIC, depth
    if not isinstance(result.occupancy, Absent) and is_ros_time:
        yield topics.OCCUPANCY_TOPIC, pack_occupancy_grid(stamp_ns, EGO, result.occupancy)
    if not isinstance(result.odometry, Absent):
        yield from _odometry(stamp_ns, sample.anchor.odom, result.odometry, trajectory)
    if edges := _edges(sample.anchor, result.odometry):
        yield topics.TF_TOPIC, encoding.encode_transforms(stamp_ns, edges)
    yield topics.METRICS_TOPIC, encode_metrics(sample.frame.camera.frame_id, metrics)
    for reason in metrics.reasons:
        if reason not in previous_reasons:
            yield topics.LOG_TOPIC, encoding.encode_warning(stamp_ns, f"frame {sample.index}: {reason}")


def _surface(sample: Sample, result: FrameResult) -> Written:
    stamp_ns, frame = result.stamp_ns, sample.frame
    if not isinstance(result.surface, Absent):
        yield topics.SURFACE_TOPIC, encoding.encode_surface(stamp_ns, result.surface)
    if not isinstance(result.drivable, Absent):
        png = encode_mask(result.drivable, DRIVABLE_COLOURS)
        yield topics.DRIVABLE_TOPIC, encoding.encode_image(stamp_ns, frame.camera.frame_id, "png", png)
        if not isinstance(result.front_surface, Absent):
            scene = annotations.drivable_scene(
                stamp_ns, result.front_surface, frame.camera, frame.ego_T_camera, result.drivable
            )
            yield topics.DRIVABLE_SCENE_TOPIC, scene


def _lanes_and_objects(sample: Sample, result: FrameResult) -> Written:
    stamp_ns, camera = result.stamp_ns, sample.frame.camera
    if not isinstance(result.lanes, Absent):
        yield topics.LANES_TOPIC, encoding.encode_lanes(stamp_ns, camera.frame_id, result.lanes)
        yield topics.LANES_ANNOTATIONS_TOPIC, annotations.lane_annotations(stamp_ns, camera, result.lanes)
        yield topics.LANES_SCENE_TOPIC, annotations.lanes_scene(stamp_ns, result.lanes)
    if not isinstance(result.objects, Absent):
        yield topics.OBJECTS_TOPIC, encoding.encode_objects(stamp_ns, camera.frame_id, result.objects)
        yield topics.OBJECTS_ANNOTATIONS_TOPIC, annotations.object_annotations(stamp_ns, camera, result.objects)
        scene = annotations.objects_scene(stamp_ns, camera, sample.frame.ego_T_camera, result.objects)
        yield topics.OBJECTS_SCENE_TOPIC, scene


def _odometry(stamp_ns: int, odom: str, odometry: Odometry, trajectory: Sequence[Float]) -> Written:
    """Odometry messages. A lost frame has no pose message, as its pose is that of an earlier frame."""
    yield topics.ODOMETRY_STATE_TOPIC, encoding.encode_odometry(stamp_ns, EGO, odometry)
    yield topics.TRAJECTORY_TOPIC, encoding.encode_poses(stamp_ns, odom, trajectory)
    if odometry.has_pose:
        yield topics.ODOMETRY_TOPIC, encoding.encode_pose(stamp_ns, odom, odometry.odom_T_ego)


def _edges(anchor: FrameAnchor, odometry: Odometry | Absent) -> list[Transform]:
    """The edges between ego and the log's tree, and between odom and ego; ego has one parent at most."""
    edges = []
    if anchor.frame_id:
        edges.append(_edge_between(anchor.frame_id, EGO, inverse(anchor.ego_T_frame), anchor.placed))
    if not isinstance(odometry, Absent) and odometry.has_pose:
        edges.append(_edge_between(anchor.odom, EGO, odometry.odom_T_ego, not anchor.placed))
    return edges


def _edge_between(frame_id: str, other: str, frame_T_other: Float, above: bool) -> Transform:
    """The edge between two frames; ``above`` makes the first one the parent."""
    if above:
        return Transform(frame_id, other, frame_T_other)
    return Transform(other, frame_id, inverse(frame_T_other))


def encode_metrics(frame_id: str, metrics: FrameMetrics) -> bytes:
    """roadperc.FrameMetrics: the row, unknown fields absent."""
    message = row_messages.FrameMetrics(frame_id=frame_id, **cells(metrics))
    set_stamp(message, metrics.stamp_ns)
    data: bytes = message.SerializeToString()
    return data


def decode_metrics(data: bytes) -> FrameMetrics:
    """The row of a roadperc.FrameMetrics.

    Raises:
        DecodeError: the bytes are invalid, or a number is not finite.
    """
    try:
        message = row_messages.FrameMetrics.FromString(data)
    except ProtobufError as error:
        raise DecodeError(f"{len(data)} bytes are not a roadperc.FrameMetrics: {error}") from error
    known: dict[str, Any] = {name: optional(message, name) for name in _OPTIONAL}
    known |= {name: tuple(getattr(message, name)) for name in _LISTS}
    known |= {name: getattr(message, name) for name in _COLUMNS - known.keys()}
    numbers = (*message.true_object_distances_m, *message.true_object_laterals_m)
    require_finite("metrics", *(value for value in known.values() if isinstance(value, float)), *numbers)
    return FrameMetrics(**known | {"reasons": tuple(map(reason_in, message.reasons))})
