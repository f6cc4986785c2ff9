"""The content of logs before it is damaged: small logs with every role and every schema that is read."""

import io
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import Message as ProtobufMessage
from mcap.writer import Writer

from roadperc_stream import log
from roadperc_stream.formats import images
from roadperc_stream.geometry import transform
from roadperc_stream.log import Attachment, Channel, Message, Metadata
from roadperc_stream.output import encoding
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES, set_stamp
from roadperc_stream.schemas.roles import ROLES
from tests import commands, foxglove_json, logs, rosbag
from tests.analytic import STEP_NS, Road
from tests.info.odd import WRITERS as ODD_WRITERS
from tests.input.test_elsewhere import TOPICS, in_ros
from tests.logs import START_NS, Item

FRAMES = 2
RESULT_FRAMES = 4
"""Of the log with results: a trajectory needs at least three."""
ROAD = Road(width=32, height=24)
TYPES: dict[str, type[ProtobufMessage]] = MESSAGE_TYPES | {"foxglove.RawImage": RawImage}
CHUNK_BYTES = 6000
WRITERS = {"lz4 and every CRC": {"enable_data_crcs": True}, **ODD_WRITERS}
BRIDGE = "/carla/ego_vehicle/"


@dataclass
class Content:
    """The content of a log, as lists that may be changed."""

    messages: list[Message] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    profile: str = ""

    def copied(self) -> "Content":
        """A copy with new lists."""
        return Content(list(self.messages), list(self.attachments), list(self.metadata), self.profile)

    def channels(self) -> list[Channel]:
        """The channels with messages, in the order of their first message."""
        return list(dict.fromkeys(message.channel for message in self.messages))


def encoded(content: Content, writer_name: str) -> bytes:
    """The bytes of a log as one of several writers would write it."""
    stream = io.BytesIO()
    writer = Writer(stream, **({"chunk_size": CHUNK_BYTES} | WRITERS[writer_name]))
    writer.start(profile=content.profile)
    ids: dict[Channel, int] = {}
    for message in content.messages:
        if message.channel not in ids:
            ids[message.channel] = _registered(writer, message.channel)
        times = {"log_time": message.log_time_ns, "publish_time": message.publish_time_ns}
        writer.add_message(ids[message.channel], data=message.data, sequence=message.sequence, **times)
    for item in content.attachments:
        writer.add_attachment(item.create_time_ns, item.log_time_ns, item.name, item.media_type, item.data)
    for record in content.metadata:
        writer.add_metadata(record.name, dict(record.values))
    writer.finish()
    return stream.getvalue()


def _registered(writer: Writer, channel: Channel) -> int:
    schema_id = 0
    if channel.schema_name:
        schema_id = writer.register_schema(channel.schema_name, channel.schema_encoding, channel.schema_data)
    return writer.register_channel(channel.topic, channel.message_encoding, schema_id, dict(channel.metadata))


def _of_items(items: list[Item]) -> Content:
    return Content([logs.message(item, sequence) for sequence, item in enumerate(items)])


def drive(frames: int = FRAMES) -> Content:
    """Foxglove's and the project's own messages, as roadperc-convert writes them; images as JPEG."""
    grey = images.encode_jpeg(np.repeat(ROAD.tags()[..., None] * 10, 3, axis=2), 90)
    found = [
        replace(item, data=encoding.encode_image(item.stamp_ns, "camera", "jpeg", grey))
        if item.role == "image"
        else item
        for item in logs.items(frames, ROAD)
    ]
    return _of_items([*found, *(_pose(k) for k in range(frames))])


def _pose(k: int) -> Item:
    pose = np.eye(4)
    pose[0, 3] = k
    stamp_ns = START_NS + k * STEP_NS
    return Item("truth_pose", stamp_ns, encoding.encode_pose(stamp_ns, "map", pose))


def truth() -> Content:
    """A log with truth: the results of its own replay."""
    content = drive()
    for message in replayed().messages:
        role = {f"/perception/{name}": f"truth_{name}" for name in ("surface", "lanes", "objects")}.get(
            message.channel.topic
        )
        if role and message.log_time_ns < START_NS + FRAMES * STEP_NS:
            content.messages.append(replace(message, channel=logs.channel(role)))
    for message in list(content.messages):
        role = {ROLES[name].topic: f"truth_{name}" for name in ("depth", "segmentation")}.get(message.channel.topic)
        if role:
            content.messages.append(replace(message, channel=logs.channel(role)))
    return content


def pair() -> Content:
    """A stereo pair and a lidar, without other depth."""
    roles = ("calibration", "tf", "segmentation")
    items = [item for item in logs.items(FRAMES, ROAD) if item.role in (*roles, "image")]
    right = replace(ROAD.camera, frame_id="right", baseline_m=0.5)
    items.append(Item("right_calibration", START_NS, encoding.encode_calibration(START_NS, right)))
    points_m = transform(ROAD.ego_T_camera, ROAD.ground()[0].reshape(-1, 3)[::3]).astype(np.float32)
    for k in range(FRAMES):
        stamp_ns = START_NS + k * STEP_NS
        noise = np.random.default_rng(k).integers(0, 255, (ROAD.height, ROAD.width), np.uint8)
        picture = encoding.encode_image(stamp_ns, "right", "png", cv2.imencode(".png", noise)[1].tobytes())
        items.append(Item("right", stamp_ns, picture))
        items.append(
            Item("lidar", stamp_ns, encoding.encode_points(stamp_ns, "ego", points_m[np.isfinite(points_m).all(1)]))
        )
    return _of_items(items)


def raw() -> Content:
    """Uncompressed images."""
    content = drive()
    pixels = {
        "image": ("bgr8", np.repeat(ROAD.tags()[..., None] * 10, 3, axis=2)),
        "depth": ("32FC1", np.nan_to_num(ROAD.depth_m()).astype("<f4")),
        "segmentation": ("mono8", ROAD.tags()),
    }
    by_topic = {ROLES[role].topic: found for role, found in pixels.items()}
    for k, message in enumerate(content.messages):
        if message.channel.topic in by_topic:
            name, array = by_topic[message.channel.topic]
            size = {"width": ROAD.width, "height": ROAD.height, "step": array[0].nbytes}
            picture = RawImage(frame_id="camera", encoding=name, data=array.tobytes(), **size)
            set_stamp(picture, message.log_time_ns)
            # The schema data remain those of compressed images; they are not read.
            channel = replace(message.channel, schema_name="foxglove.RawImage", message_encoding="protobuf")
            content.messages[k] = replace(message, channel=channel, data=picture.SerializeToString())
    return content


def as_json() -> Content:
    """Foxglove's messages as JSON; the project's own messages and depth stay protobuf."""
    content = raw()
    for k, message in enumerate(content.messages):
        name = message.channel.schema_name
        if name.startswith("foxglove."):
            channel = replace(message.channel, message_encoding="json", schema_encoding="jsonschema", schema_data=b"{}")
            text = foxglove_json.as_json(TYPES[name].FromString(message.data))
            content.messages[k] = replace(message, channel=channel, data=text)
    return content


def bag() -> Content:
    """A ROS 2 bag of CARLA's bridge."""
    content, points = Content(profile="ros2"), np.zeros((1, 64, 4), np.float32)
    points[0, :, 0] = np.linspace(3, 30, 64)

    def put(message: Message, topic: str, name: str, written: dict) -> None:
        channel = Channel(topic, "cdr", name, "ros2msg", rosbag.definition_of(name).encode())
        content.messages.append(replace(message, channel=channel, data=rosbag.serialised(name, written)))

    for message in _of_items([*logs.items(FRAMES, ROAD), *(_pose(k) for k in range(FRAMES))]).messages:
        topic = message.channel.topic
        put(message, "/tf_static" if topic == "/tf" else BRIDGE + TOPICS[topic], *in_ros(message, "bgr8"))
        if topic == "/truth/pose":
            cloud = rosbag.cloud(message.log_time_ns, "ego_vehicle", points)
            put(message, f"{BRIDGE}lidar", "sensor_msgs/msg/PointCloud2", cloud)
    return content


@cache
def results() -> dict[str, bytes]:
    """The files of a replay of the drive, by name: out.mcap and its tables."""
    with TemporaryDirectory() as folder:
        source, target = Path(folder, "in.mcap"), Path(folder, "out.mcap")
        source.write_bytes(encoded(drive(RESULT_FRAMES), "zstd"))
        # In a separate process: threads that libraries start here would be missing in forked processes.
        subprocess.run(commands.words("roadperc-replay", source, target, "--quiet", "--overlay"), check=True)
        files = [target, sidecar_path(target, "metrics"), sidecar_path(target, "objects")]
        return {path.name: path.read_bytes() for path in files}


@cache
def replayed() -> Content:
    """A log with results."""
    with TemporaryDirectory() as folder:
        target = Path(folder, "out.mcap")
        target.write_bytes(results()["out.mcap"])
        summary = log.summarise(target)
        return Content(list(log.read(summary)), list(summary.attachments), list(summary.metadata), summary.profile)


BASES: dict[str, Callable[[], Content]] = {
    "drive": cache(drive), "truth": cache(truth), "pair": cache(pair), "raw": cache(raw), "json": cache(as_json),
    "bag": cache(bag), "result": replayed,
}  # fmt: skip
