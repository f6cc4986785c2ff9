"""Changes to the content of a log: messages, their order and times, channels, attachments."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from roadperc_stream.log import Attachment, Channel, Message, Metadata
from roadperc_stream.model import Transform
from roadperc_stream.output import encoding
from roadperc_stream.schemas.definitions import types_of
from roadperc_stream.schemas.record import TAG_TABLE_KEY
from tests.analytic import box
from tests.fuzz.choices import Choices, damage, wild_float, wild_integer, wild_text
from tests.fuzz.contents import TYPES, Content
from tests.fuzz.pictures import mutate_picture
from tests.fuzz.trees import mutate_json, mutate_message, mutate_toml

LAST_NS = 2**64 - 1


def mutate_content(content: Content, choices: Choices) -> None:
    """Change the content in place, by one fault."""
    if content.messages:
        FAULTS[choices.of("do", WEIGHTED)](content, choices)


def _chosen(content: Content, choices: Choices) -> int:
    """The index of a message; every channel has the same probability."""
    channels = content.channels()
    topic = choices.of("topic", [channel.topic for channel in channels])
    places = [k for k, message in enumerate(content.messages) if message.channel.topic == topic]
    return places[choices.index("message", len(places))] if places else 0


def _payload(content: Content, choices: Choices) -> None:
    """Change a message, or all messages of its channel."""
    at = _chosen(content, choices)
    changed = _mutated(content.messages[at], choices)
    everywhere = choices.chance("everywhere", 0.3)
    for k, message in enumerate(content.messages):
        if k == at or (everywhere and message.channel == content.messages[at].channel):
            content.messages[k] = replace(message, data=changed)


def _mutated(message: Message, choices: Choices) -> bytes:
    channel = message.channel
    if choices.chance("bytes", 0.1):
        return damage(message.data, choices)
    if channel.message_encoding == "json":
        return mutate_json(message.data, choices)
    if channel.message_encoding != "cdr" and channel.schema_name not in TYPES:
        return damage(message.data, choices)
    try:
        return _with_a_field_changed(message, choices)
    except Exception:  # decoders raise any exception if bytes or a value do not fit
        return damage(message.data, choices.part("otherwise"))


def _with_a_field_changed(message: Message, choices: Choices) -> bytes:
    channel = message.channel
    if channel.message_encoding == "cdr":
        store = _layout(channel.schema_name, channel.schema_data)
        parsed = store.deserialize_cdr(message.data, channel.schema_name)
        mutate_message(parsed, choices)
        return bytes(store.serialize_cdr(parsed, channel.schema_name))
    parsed = TYPES[channel.schema_name].FromString(message.data)
    if channel.schema_name == "foxglove.CompressedImage" and choices.chance("picture", 0.6):
        parsed.data = mutate_picture(parsed.data, choices.part("pixels"))  # type: ignore[attr-defined]
    else:
        mutate_message(parsed, choices)
    return parsed.SerializeToString()


@cache
def _layout(name: str, definition: bytes) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register(types_of(name, definition, "ros2msg"))
    return store


def _log_time(content: Content, choices: Choices) -> None:
    """Change the log time of one message, or of all later ones too."""
    at, value = _chosen(content, choices), wild_integer(choices) % (LAST_NS + 1)
    last = len(content.messages) if choices.chance("rest", 0.3) else at + 1
    for k in range(at, last):
        content.messages[k] = replace(content.messages[k], log_time_ns=value)


def _order(content: Content, choices: Choices) -> None:
    """Change the order of the messages, but not of their log times."""
    times = [message.log_time_ns for message in content.messages]
    by = choices.index("by", len(times))
    turned = content.messages[::-1] if choices.chance("reverse", 0.5) else content.messages[by:] + content.messages[:by]
    content.messages[:] = [replace(m, log_time_ns=t) for m, t in zip(turned, times, strict=True)]


def _drop_channel(content: Content, choices: Choices) -> None:
    topic = content.messages[_chosen(content, choices)].channel.topic
    content.messages[:] = [message for message in content.messages if message.channel.topic != topic]


def _repeat(content: Content, choices: Choices) -> None:
    at = _chosen(content, choices)
    content.messages[at:at] = [content.messages[at]] * choices.of("copies", (1, 3, 50))


def _channel(content: Content, choices: Choices) -> None:
    """Change one field of a channel."""
    old = content.messages[_chosen(content, choices)].channel
    word = choices.of(
        "word", ("topic", "topic", "message_encoding", "schema_name", "schema_encoding", "schema_data", "metadata")
    )
    if word == "schema_data":
        new = replace(old, schema_data=damage(old.schema_data, choices))
    elif word == "metadata":
        key = choices.of("key", ("producer", TAG_TABLE_KEY, "offered_qos_profiles", ""))
        new = replace(old, metadata=((key, wild_text(choices)),))
    else:
        known = tuple(getattr(channel, word) for channel in content.channels())
        value = choices.of("known", known) if choices.chance("of_another", 0.3) else wild_text(choices)
        new = replace(old, **{word: value})
    content.messages[:] = [replace(m, channel=new) if m.channel == old else m for m in content.messages]


def _attach(content: Content, choices: Choices) -> None:
    """Damage an attachment of the project, or add an unknown one."""
    name = choices.of("name", ("roadperc.toml", "roadperc.state", "notes.txt", wild_text(choices)))
    known = [item for item in content.attachments if item.name == name]
    before = known[0].data if known else CONFIGURATION
    inner = choices.part("damage")
    data = mutate_toml(before, inner) if name == "roadperc.toml" else damage(before, inner)
    content.attachments = [item for item in content.attachments if item.name != name]
    content.attachments.append(
        Attachment(name, wild_text(choices, "media_type"), data, wild_integer(choices, "time") % 2**64)
    )


CONFIGURATION = b"seed = 1\n[lanes]\nhold_s = 0.5\n[surface]\nmodel = 'plane'\n"


def _metadata(content: Content, choices: Choices) -> None:
    """Change the metadata record of a replay."""
    known = dict(next((record.values for record in content.metadata if record.name == "roadperc"), ()))
    keys = (*known, "digest", "version", "seed", "topic.image", "frames", "input_messages", "")
    key = choices.of("key", keys)
    values = known | {key: wild_text(choices) if choices.chance("text", 0.7) else str(wild_integer(choices, "number"))}
    if choices.chance("remove", 0.2):
        values.pop(key)
    content.metadata = [record for record in content.metadata if record.name != "roadperc"]
    content.metadata.append(Metadata("roadperc", tuple(values.items())))


def _transforms(content: Content, choices: Choices) -> None:
    """Add transforms that do not form a tree."""
    kind, length = choices.of("kind", ("chain", "loop", "twice", "self", "far")), choices.of("length", (2, 30, 500))
    names = [f"frame{k}" for k in range(length)]
    edges = {
        "chain": pairwise(["ego", *names, "camera"]),
        "loop": pairwise([*names, names[0]]),
        "twice": [("map", "camera"), ("ego", "camera")] * length,
        "self": [("camera", "camera"), ("ego", "ego")],
        "far": [("ego", "camera")],
    }[kind]
    matrix = np.eye(4)
    matrix[0, 3] = choices.of("x_m", (0.0, 1e9, 1e300, math.nan))
    first = content.messages[0]
    for channel in content.channels():
        if channel.schema_name == "foxglove.FrameTransforms":
            data = encoding.encode_transforms(first.log_time_ns, [Transform(*edge, matrix) for edge in edges])
            content.messages.insert(0, replace(first, channel=channel, data=data))


def _detections(content: Content, choices: Choices) -> None:
    """Replace the detections by many boxes or by invalid ones."""
    numbers = [wild_float(choices, name) for name in ("x_min", "y_min", "x_max", "y_max", "score")]
    count, label = choices.of("count", (1, 10, 200)), wild_text(choices, "label")
    found = [box(label, *numbers)] * count if choices.chance("odd", 0.5) else [box("Car", 2, 3, 20, 20)] * count
    for k, message in enumerate(content.messages):
        if message.channel.schema_name == "roadperc.Detections":
            data = encoding.encode_detections(message.log_time_ns, "camera", found)
            content.messages[k] = replace(message, data=data)


def _foreign(content: Content, choices: Choices) -> None:
    """Add an unknown channel with messages."""
    channel = Channel(
        wild_text(choices, "topic"), wild_text(choices, "encoding"), wild_text(choices, "schema"), "ros2msg", b"x"
    )
    at = choices.index("at", len(content.messages))
    message = Message(channel, content.messages[at].log_time_ns, wild_integer(choices) % 2**64, 0, b"\0" * 8)
    content.messages[at:at] = [message] * choices.of("copies", (1, 5))


FAULTS: dict[str, Callable[[Content, Choices], object]] = {
    "payload": _payload, "log_time": _log_time, "order": _order, "repeat": _repeat,
    "drop": lambda content, choices: content.messages.pop(_chosen(content, choices)), "drop_channel": _drop_channel,
    "channel": _channel, "attach": _attach, "metadata": _metadata, "transforms": _transforms,
    "detections": _detections, "foreign": _foreign,
}  # fmt: skip
WEIGHTED = ("payload",) * 14 + ("channel",) * 3 + tuple(FAULTS)
"""Messages have the most kinds of faults, so most changes are there."""
