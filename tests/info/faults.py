"""Faults of recordings, each as a function of the messages of a good log, and what its contract says of it."""

import itertools
import struct
from dataclasses import replace

import cv2
import numpy as np

from roadperc_stream.formats import images
from roadperc_stream.log import Channel, Message
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14
from roadperc_stream.schemas import cdr, ros2
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES, set_stamp, stamp_ns
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.time import NS_PER_S

IMAGE, DEPTH, TAGS = (ROLES[role].topic for role in ("image", "depth", "segmentation"))
BOXES, FRONT, RIGHT = (ROLES[role].topic for role in ("detections", "calibration", "right_calibration"))
RIGHT_IMAGE, TF, POSE, OWN = ROLES["right"].topic, "/tf", "/truth/pose", "/vehicle/speed"
MS = NS_PER_S // 1000
_DEPTH_STAMP_AT = 4


def with_own_topic(messages):
    """The messages, and the vehicle's speed at 10 Hz, which no stage reads."""
    channel = Channel(OWN, "json", "vehicle.Speed", "jsonschema", b"{}")
    times = sorted({message.log_time_ns for message in messages})
    own = [Message(channel, at_ns, at_ns, k, b'{"mps": 10.0}') for k, at_ns in enumerate(times)]
    return sorted((*messages, *own), key=lambda message: message.log_time_ns)


def edited(messages, topic, edit):
    """The messages with those of a topic replaced by ``edit(message, number)``; None leaves one out."""
    numbers = itertools.count()
    found = [edit(m, next(numbers)) if m.channel.topic == topic else m for m in messages]
    return sorted((m for m in found if m is not None), key=lambda message: message.log_time_ns)


def content(message):
    return MESSAGE_TYPES[message.channel.schema_name].FromString(message.data)


def with_content(message, change):
    found = content(message)
    change(found)
    return replace(message, data=found.SerializeToString(deterministic=True))


def stamped_later(message, by_ns):
    """The message with a later stamp and the same log time."""
    if message.channel.message_encoding == "cdr":
        data = bytearray(message.data)
        seconds, nanos = struct.unpack_from("<iI", data, _DEPTH_STAMP_AT)
        struct.pack_into("<iI", data, _DEPTH_STAMP_AT, *divmod(seconds * NS_PER_S + nanos + by_ns, NS_PER_S))
        return replace(message, data=bytes(data))
    if message.channel.topic in (OWN, TF):
        return message
    return with_content(message, lambda found: set_stamp(found, stamp_ns(found.timestamp) + by_ns))


def arriving_later(message, by_ns):
    return replace(message, log_time_ns=message.log_time_ns + by_ns, publish_time_ns=message.publish_time_ns + by_ns)


def later(message, by_ns):
    return arriving_later(stamped_later(message, by_ns), by_ns)


def picture(message, change, suffix=".png"):
    """The message with a changed image file."""

    def changed(found):
        pixels = cv2.imdecode(np.frombuffer(found.data, np.uint8), cv2.IMREAD_UNCHANGED)
        found.data = cv2.imencode(suffix, change(pixels))[1].tobytes()
        found.format = {".png": "png", ".jpg": "jpeg"}[suffix]

    return with_content(message, changed)


def frozen(messages):
    """From the tenth image on, the camera sends the same image with new stamps."""
    held = []

    def repeated(message, number):
        if number == 10:
            held.append(content(message).data)
        return message if number < 10 else with_content(message, lambda found: setattr(found, "data", held[0]))

    return edited(messages, IMAGE, repeated)


def other_tags(messages):
    """The segmentation has the numbers of another table: each tag is 11 more."""

    def changed(found):
        tags = images.decode_indices(found.data)
        found.data = images.encode_indices((tags + 11) % 22, CARLA_FROM_0_9_14.colours)

    return edited(messages, TAGS, lambda message, _: with_content(message, changed))


def in_centimetres(message, _):
    name = message.channel.schema_name
    image = cdr.read(message.data, name, ros2.DEFINITIONS[name])
    depth = np.asarray(image.data, np.uint8).view("<u2") // 10
    return replace(message, data=message.data[: -depth.nbytes] + depth.tobytes())


def scaled_K(message, _):
    def changed(found):
        for matrix, places in ((found.K, (0, 4)), (found.P, (0, 5))):
            for place in places:
                matrix[place] *= 1.1

    return with_content(message, changed)


def exchanged(messages):
    """The calibrations of the front and the right camera are exchanged."""
    by_topic = {message.channel.topic: message.data for message in messages if message.channel.topic in (FRONT, RIGHT)}
    other = {FRONT: RIGHT, RIGHT: FRONT}
    return [replace(m, data=by_topic[other[m.channel.topic]]) if m.channel.topic in other else m for m in messages]


def raised(message, _):
    """The front camera is mounted 0.2 m higher."""

    def changed(found):
        for transform in found.transforms:
            if transform.child_frame_id in ("camera", "camera_front"):
                transform.translation.z += 0.2

    return with_content(message, changed)


def without_some(topic, numbers):
    return lambda messages: edited(messages, topic, lambda message, k: None if k in numbers else message)


def each(topic, edit):
    return lambda messages: edited(messages, topic, edit)


def clock_set(messages):
    """The computer's clock jumps ahead by 5 s in the middle of the log."""
    middle_ns = (messages[0].log_time_ns + messages[-1].log_time_ns) // 2
    return [later(m, 5 * NS_PER_S) if m.log_time_ns > middle_ns else m for m in messages]


def no_boxes(message, _):
    return with_content(message, lambda found: found.ClearField("detections"))


def halved(pixels):
    return cv2.resize(pixels, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_NEAREST)


def renamed(message, _):
    return replace(message, channel=replace(message.channel, topic="/vehicle/velocity"))


FAULTS = {
    "rate halved": (without_some(IMAGE, range(1, 99, 2)), IMAGE, "rate_hz"),
    "a fifth of the messages lost": (without_some(RIGHT_IMAGE, range(3, 99, 5)), RIGHT_IMAGE, "rate_hz"),
    "camera frozen": (frozen, IMAGE, "repeats"),
    "offset of 50 ms": (each(DEPTH, lambda m, _: later(m, 50 * MS)), DEPTH, "offset_s"),
    "stamps 50 ms late": (each(TAGS, lambda m, _: stamped_later(m, 50 * MS)), TAGS, "latency_s"),
    "topic gone": (without_some(DEPTH, range(99)), DEPTH, "topic"),
    "own topic gone": (without_some(OWN, range(99)), OWN, "topic"),
    "own topic renamed": (each(OWN, renamed), OWN, "topic"),
    "own topic slow": (without_some(OWN, range(1, 99, 2)), OWN, "rate_hz"),
    "another resolution": (each(IMAGE, lambda m, _: picture(m, halved)), IMAGE, "sizes"),
    "another resolution for one image": (
        each(IMAGE, lambda m, k: picture(m, halved) if k == 12 else m),
        IMAGE,
        "sizes",
    ),
    "clock jumps ahead": (clock_set, IMAGE, "gap_s"),
    "stamps jump ahead": (each(IMAGE, lambda m, k: stamped_later(m, 3 * NS_PER_S * (k > 20))), IMAGE, "gap_s"),
    "another focal length": (each(FRONT, scaled_K), FRONT, "fx"),
    "calibrations exchanged": (exchanged, RIGHT, "baseline_m"),
    "no calibration": (without_some(FRONT, range(99)), FRONT, "topic"),
    "camera mounted higher": (each(TF, raised), FRONT, "z_m"),
    "no transforms": (without_some(TF, range(99)), TF, "topic"),
    "jpeg for png": (each(IMAGE, lambda m, _: picture(m, lambda pixels: pixels, ".jpg")), IMAGE, "codings"),
    "lens covered": (each(IMAGE, lambda m, _: picture(m, np.zeros_like)), IMAGE, "message_bytes"),
    "other tags": (other_tags, TAGS, "road_share"),
    "depth in centimetres": (each(DEPTH, in_centimetres), DEPTH, "depth_m"),
    "gap of 2 s": (without_some(TAGS, range(5, 25)), TAGS, "gap_s"),
    "starts 1 s late": (without_some(RIGHT_IMAGE, range(10)), RIGHT_IMAGE, "gap_s"),
    "stops 1 s early": (without_some(BOXES, range(20, 99)), BOXES, "gap_s"),
    "duplicate stamps": (
        each(IMAGE, lambda m, k: stamped_later(m, -100 * MS) if k % 5 == 4 else m),
        IMAGE,
        "stamps_repeated",
    ),
    "stamps back": (each(BOXES, lambda m, k: stamped_later(m, -150 * MS) if k == 15 else m), BOXES, "stamps_back"),
    "latency grows": (each(TAGS, lambda m, k: arriving_later(m, 10 * MS * k)), TAGS, "latency_s"),
    "unsteady": (each(OWN, lambda m, k: arriving_later(m, 40 * MS * (k % 2))), OWN, "jitter_s"),
    "no detections": (each(BOXES, no_boxes), BOXES, "detections"),
    "another type": (
        each(OWN, lambda m, _: replace(m, channel=replace(m.channel, schema_name="vehicle.Velocity"))),
        OWN,
        "types",
    ),
    "another type of a role": (
        each(TAGS, lambda m, _: replace(m, channel=replace(m.channel, message_encoding="json"))),
        TAGS,
        "types",
    ),
    "another frame": (
        each(IMAGE, lambda m, _: with_content(m, lambda found: setattr(found, "frame_id", "camera_rear"))),
        IMAGE,
        "frame_ids",
    ),
    "messages unreadable": (each(TAGS, lambda m, k: replace(m, data=b"\xff") if k % 3 == 0 else m), TAGS, "unreadable"),
    "truth gone": (without_some(POSE, range(99)), POSE, "topic"),
}
"""By name: the fault, and a topic and a key of what is broken."""
