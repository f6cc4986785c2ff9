"""Small logs of the analytic road, written through the package's own encoders."""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from roadperc_stream.formats import images
from roadperc_stream.log import Channel, LogWriter, Message
from roadperc_stream.model import Transform
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE
from roadperc_stream.output import encoding
from roadperc_stream.schemas.protobuf import schema
from roadperc_stream.schemas.record import TAG_TABLE_KEY
from roadperc_stream.schemas.roles import ROLES
from tests.analytic import STEP_NS, Road, box

START_NS = 1_600_000_000_000_000_000
SMALL = Road(width=320, height=240)
ALL = ("calibration", "tf", "image", "depth", "segmentation", "detections")


@dataclass(frozen=True)
class Item:
    """A message of a role."""

    role: str
    stamp_ns: int
    data: bytes
    topic: str = ""


def channel(role, topic="", **labels):
    found = schema(ROLES[role].schema)
    metadata = {TAG_TABLE_KEY: TABLE.name} if ROLES[role].kind == "tags" else {}
    labels = tuple(sorted((metadata | labels).items()))
    return Channel(
        topic or ROLES[role].topic, found.message_encoding, found.name, found.schema_encoding, found.data, labels
    )


def items(frames=6, road=SMALL, roles=ALL):
    """Messages of a drive with a varying lateral offset, in recording order."""
    made = []
    if "calibration" in roles:
        made.append(Item("calibration", START_NS, encoding.encode_calibration(START_NS, road.camera)))
    if "tf" in roles:
        edge = Transform("ego", "camera", road.ego_T_camera)
        made.append(Item("tf", START_NS, encoding.encode_transforms(START_NS, [edge])))
    for k in range(frames):
        stamp = START_NS + k * STEP_NS
        made += [item for item in frame_items(stamp, shifted(road, k)) if item.role in roles]
    return made


def shifted(road, k):
    sideways = 0.05 * np.sin(k / 3)
    return replace(road, left_m=road.left_m + sideways, right_m=road.right_m + sideways)


@lru_cache(maxsize=256)
def frame_items(stamp, road):
    tags = road.tags()
    palette = images.encode_indices(tags, TABLE.colours)
    grey = cv2.imencode(".png", tags * 10)[1].tobytes()
    boxes = [box("Car", 20, 60, 60, 90), box("Pedestrian", 200, 100, 220, 140)]
    return [
        Item("image", stamp, encoding.encode_image(stamp, "camera", "png", grey)),
        Item("depth", stamp, encoding.encode_depth(stamp, "camera", road.depth_m())),
        Item("segmentation", stamp, encoding.encode_image(stamp, "camera", "png", palette)),
        Item("detections", stamp, encoding.encode_detections(stamp, "camera", boxes)),
    ]


def foreign():
    """A message of a channel that this project does not know."""
    unknown = Channel("/rosout", "cdr", "rcl_interfaces/msg/Log", "ros2msg", b"string msg\n")
    return Message(unknown, 5, 5, 0, b"\0\1\0\0\0\0\0\0")


def message(item, sequence, **labels):
    return Message(channel(item.role, item.topic, **labels), item.stamp_ns, item.stamp_ns, sequence, item.data)


def write(path, messages, extra=()):
    with LogWriter(path) as writer:
        for sequence, item in enumerate(messages):
            writer.write(message(item, sequence))
        for whole in extra:
            writer.write(whole)
    return path
