"""Draws the messages of a log with one function per channel."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any, Final

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry.rectification import is_rectified
from roadperc_stream.input.decoding import Context, context_of_channel, decode
from roadperc_stream.input.earlier_replay import is_result, is_result_of
from roadperc_stream.input.rectified import rectified
from roadperc_stream.input.stream import RoleAssignment
from roadperc_stream.log import Channel, Message
from roadperc_stream.model.tag_tables import TagTable
from roadperc_stream.output.results import DRIVABLE_COLOURS
from roadperc_stream.schemas import cdr, ros2, topics
from roadperc_stream.schemas.roles import Kind
from roadperc_stream.schemas.row_messages import FrameMetrics
from roadperc_stream.view.rerun import overlays, pictures, scene
from roadperc_stream.view.rerun.tree import Entry, SceneState
from roadperc_stream.view.result_frames import TimesOfFrame

Drawer = Callable[[Message], Iterator[Entry]]

_KINDS: Final[Mapping[Kind, Callable[[str, str, Any, SceneState], Iterator[Entry]]]] = {
    "image": pictures.image,
    "tags": pictures.tags,
    "instances": pictures.instances,
    "depth": pictures.depth,
    "calibration": pictures.calibration,
    "points": scene.points,
    "tf": scene.transforms,
    "pose": scene.pose,
    "surface": scene.road,
    "detections": overlays.detections,
    "objects": overlays.objects,
    "lanes": overlays.lanes,
}
_RESULT_KINDS: Final[Mapping[str, tuple[Kind, str]]] = {
    topics.SURFACE_TOPIC: ("surface", "result"),
    topics.DRIVABLE_TOPIC: ("tags", "image"),
    topics.LANES_TOPIC: ("lanes", "result"),
    topics.OBJECTS_TOPIC: ("objects", "result"),
    topics.STEREO_DEPTH_TOPIC: ("depth", "left"),
    topics.ODOMETRY_TOPIC: ("pose", "result"),
    topics.TF_TOPIC: ("tf", "result"),
}
"""Results with the message kind of an input, and the role whose camera they belong to."""
_PICTURES: Final = (topics.OVERLAY_TOPIC, topics.DEBUG_PREFIX)
_DRIVABLE: Final = TagTable("drivable", ("other", "drivable"), DRIVABLE_COLOURS)
_PARSERS: Final[Mapping[str, tuple[Callable[[bytes], Any], Callable[[str, Any], Iterator[Entry]]]]] = {
    topics.DRIVABLE_SCENE_TOPIC: (SceneUpdate.FromString, scene.outlines),
    topics.TRAJECTORY_TOPIC: (PosesInFrame.FromString, scene.trajectory),
    topics.LOG_TOPIC: (Log.FromString, scene.log_line),
    topics.OCCUPANCY_TOPIC: (
        lambda data: cdr.read(data, ros2.OCCUPANCY_GRID, ros2.DEFINITIONS[ros2.OCCUPANCY_GRID]),
        scene.occupancy,
    ),
}


def drawers(
    channels: Iterable[Channel], assigned: RoleAssignment, state: SceneState, times: TimesOfFrame
) -> dict[Channel, Drawer]:
    """The function that draws the messages of each channel, for channels with a role or results."""
    return {channel: drawer for channel in channels if (drawer := _drawer(channel, assigned, state, times))}


def _drawer(channel: Channel, assigned: RoleAssignment, state: SceneState, times: TimesOfFrame) -> Drawer | None:
    if is_result(channel):
        return _result_drawer(channel, state, times)
    role = next(iter(assigned.roles_of(channel.topic)), None)
    return None if role is None else _kind_drawer(channel, role.kind, role.name, state, assigned.tag_table)


def _result_drawer(channel: Channel, state: SceneState, times: TimesOfFrame) -> Drawer | None:
    topic = channel.topic
    if not is_result_of(channel, topic):
        return None
    if topic == topics.METRICS_TOPIC:
        return partial(_parsed, FrameMetrics.FromString, partial(_numbers, times, state))
    if topic in _PARSERS:
        return partial(_parsed, *_PARSERS[topic])
    if topic.startswith(_PICTURES):
        return partial(_encoded, "image", state)
    if topic in _RESULT_KINDS:
        return _kind_drawer(channel, *_RESULT_KINDS[topic], state)
    return None


def _kind_drawer(channel: Channel, kind: Kind, role: str, state: SceneState, tag_table: str = "") -> Drawer:
    if kind == "image" and (channel.schema_name, channel.message_encoding) == (topics.IMAGE_SCHEMA, "protobuf"):
        return partial(_encoded, role, state)
    context = context_of_channel(channel, "auto", tag_table)
    context = Context(_DRIVABLE) if kind == "tags" and is_result(channel) else context
    return partial(_decoded, kind, role, context, state)


def _parsed(
    parse: Callable[[bytes], Any], draw: Callable[[str, Any], Iterator[Entry]], message: Message
) -> Iterator[Entry]:
    try:
        content = parse(message.data)
    except ProtobufError as error:
        raise DecodeError(f"{len(message.data)} bytes are not a {message.channel.schema_name}: {error}") from error
    return draw(message.channel.topic, content)


def _numbers(times: TimesOfFrame, state: SceneState, entity: str, message: Any) -> Iterator[Entry]:
    """A frame's metrics, and its stage times from the table."""
    yield from scene.metrics(entity, message, state)
    yield from scene.times(topics.TIMES_TOPIC, times(message.log_id, message.frame))


def _encoded(role: str, state: SceneState, message: Message) -> Iterator[Entry]:
    """The image in its encoded form, or rectified if its camera has a lens."""
    camera = state.camera_of(role)
    if camera is not None and not is_result(message.channel) and not is_rectified(camera):
        return _decoded("image", role, Context(), state, message)

    def draw(entity: str, content: Any) -> Iterator[Entry]:
        yield pictures.encoded(entity, content.data, content.format, state.image_frame(role, content.frame_id))

    return _parsed(CompressedImage.FromString, draw, message)


def _decoded(kind: Kind, role: str, context: Context, state: SceneState, message: Message) -> Iterator[Entry]:
    channel, data, time_ns = message.channel, message.data, message.log_time_ns
    decoded = decode(kind, channel.schema_name, channel.message_encoding, data, time_ns, context)
    payload = decoded.payload if is_result(channel) else rectified(decoded.payload, state.camera_of(role))
    return _KINDS[kind](channel.topic, role, payload, state)
