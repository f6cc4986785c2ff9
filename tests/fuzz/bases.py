"""The intact inputs: small logs, their results and tables, and a dump."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer

from roadperc_stream import log
from roadperc_stream.geometry import transform
from roadperc_stream.log import Channel
from roadperc_stream.output import encoding
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES
from tests import foxglove_json, logs, rosbag
from tests.analytic import STEP_NS, Road
from tests.commands import run_forked
from tests.input.test_elsewhere import TOPICS, in_ros
from tests.logs import START_NS, Item
from tests.tools import dump_writer

ROAD = Road(width=32, height=24)
FRAMES = 3
UNINDEXED = {
    "use_chunking": False, "index_types": IndexType.NONE, "use_statistics": False, "use_summary_offsets": False,
    "repeat_channels": False, "repeat_schemas": False, "enable_crcs": False,
}  # fmt: skip
"""Options of a log without offsets and checksums: what is changed in it is its only fault."""
CHUNKED = {"chunk_size": 6000, "compression": CompressionType.LZ4}


@cache
def drive():
    """Messages of every input role, truth and lidar included."""
    items = logs.items(FRAMES, ROAD)
    points = transform(ROAD.ego_T_camera, ROAD.ground()[0].reshape(-1, 3)[::3]).astype(np.float32)
    points = points[np.isfinite(points).all(1)]
    for k in range(FRAMES):
        stamp_ns, pose = START_NS + k * STEP_NS, np.eye(4)
        pose[0, 3] = k
        items.append(Item("lidar", stamp_ns, encoding.encode_points(stamp_ns, "ego", points)))
        items.append(Item("truth_pose", stamp_ns, encoding.encode_pose(stamp_ns, "map", pose)))
    return [logs.message(item, sequence) for sequence, item in enumerate(items)]


@cache
def as_json():
    """The drive with Foxglove's messages as JSON."""
    made = []
    for message in drive():
        if message.channel.schema_name.startswith("foxglove."):
            text = foxglove_json.as_json(MESSAGE_TYPES[message.channel.schema_name].FromString(message.data))
            channel = replace(message.channel, message_encoding="json", schema_encoding="jsonschema", schema_data=b"{}")
            made.append(replace(message, channel=channel, data=text))
        else:
            made.append(message)
    return made


@cache
def bag():
    """The drive as a ROS 2 bag of CARLA's bridge."""
    made = []
    for message in drive():
        topic = message.channel.topic
        if topic in TOPICS:
            name, written = in_ros(message, "bgr8")
            topic = "/tf_static" if topic == "/tf" else f"/carla/ego_vehicle/{TOPICS[topic]}"
            channel = Channel(topic, "cdr", name, "ros2msg", rosbag.definition_of(name).encode())
            made.append(replace(message, channel=channel, data=rosbag.serialised(name, written)))
    return made


MESSAGES = {"drive": drive, "json": as_json, "bag": bag}


def log_of(messages, **options):
    """The bytes of a log as another program would write it."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "in.mcap")
        with path.open("wb") as stream:
            writer, ids = Writer(stream, **(options or CHUNKED)), {}
            writer.start()
            for message in messages:
                channel = message.channel
                if channel not in ids:
                    schema = (channel.schema_name, channel.schema_encoding, channel.schema_data)
                    of = writer.register_schema(*schema) if channel.schema_name else 0
                    ids[channel] = writer.register_channel(
                        channel.topic, channel.message_encoding, of, dict(channel.metadata)
                    )
                times = message.log_time_ns % 2**64, message.publish_time_ns % 2**64
                writer.add_message(ids[channel], times[0], message.data, times[1], message.sequence)
            writer.finish()
        return path.read_bytes()


@cache
def results():
    """The files of a replay of the drive: out.mcap and its tables."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "in.mcap").write_bytes(log_of(drive()))
        done = run_forked("roadperc-replay", "in.mcap", "out.mcap", cwd=folder)
        assert done.returncode == 0, done.stderr
        return {path.name: path.read_bytes() for path in folder.glob("out.*")}


@cache
def dump():
    """The files of a folder of frames with every kind of document."""
    with TemporaryDirectory() as name:
        folder = dump_writer.plain_dump(Path(name), (0, 1))
        return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def messages_of(path):
    """The messages of a log."""
    return list(log.read(log.summarise(path)))
