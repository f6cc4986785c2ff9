"""Logs whose messages, channels, times and images are wrong."""

import json
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.schemas.protobuf import MESSAGE_TYPES
from tests.fuzz import bases
from tests.fuzz.running import examples, folder_of, require_clear_end
from tests.fuzz.values import changed, damaged, floats, integers, texts

COMMANDS = st.sampled_from((
    "replay in.mcap result.mcap", "replay in.mcap result.mcap --overlay --debug",
    "replay in.mcap result.mcap --set stereo.method=full --set surface.model=spline", "info in.mcap",
    "view in.mcap --save view.rrd", "view in.mcap --foxglove-layout view.json",
    "sweep in.mcap --vary lanes.hold_s=0.2,0.5 --out sweep --jobs 1",
))  # fmt: skip
OF_RESULTS = st.sampled_from((
    "view in.mcap --video view.mp4", "lanes in.mcap --tusimple lanes.json", "view in.mcap --save view.rrd",
    "replay in.mcap result.mcap",
))  # fmt: skip


@st.composite
def changed_message(draw, message):
    """A protobuf message with one field changed, at any depth."""
    owner, field = draw(st.sampled_from(list(_fields(message))))
    if field.is_repeated:
        items = list(getattr(owner, field.name)) * draw(st.sampled_from((0, 2, 1000)))
        owner.ClearField(field.name)
        getattr(owner, field.name).extend(items)
    elif field.message_type:
        owner.ClearField(field.name)
    else:
        kinds = {1: integers(32, signed=True), 2: integers(64, signed=True), 3: integers(32), 4: integers(64),
                 5: floats, 6: floats, 7: st.booleans(), 8: st.integers(0, 3), 9: texts}  # fmt: skip
        value = draw(damaged(owner.data)) if field.type == field.TYPE_BYTES else draw(kinds[field.cpp_type])
        setattr(owner, field.name, value)
    return message.SerializeToString()


def _fields(message):
    """(owner, field) of every field of a message and its submessages; of repeated ones the first."""
    for field in message.DESCRIPTOR.fields:
        yield message, field
        inner = getattr(message, field.name)
        if field.message_type and field.is_repeated:
            inner = inner[0] if len(inner) else None
        if field.message_type and inner is not None:
            yield from _fields(inner)


@st.composite
def changed_data(draw, message):
    """The data of a message with a fault that its encoding may have."""
    if draw(st.integers(0, 4)) == 0 or message.channel.message_encoding == "cdr":
        return draw(damaged(message.data))
    if message.channel.message_encoding == "json":
        return json.dumps(draw(changed(json.loads(message.data)))).encode("utf-8", "surrogatepass")
    kind = MESSAGE_TYPES.get(message.channel.schema_name)
    return draw(changed_message(kind.FromString(message.data)) if kind else damaged(message.data))


@st.composite
def changed_channel(draw, channel):
    """A channel with another name, encoding or schema."""
    name = draw(st.sampled_from(("topic", "message_encoding", "schema_name", "schema_encoding", "metadata")))
    return replace(channel, **{name: (("tags", draw(texts)),) if name == "metadata" else draw(texts)})


@st.composite
def changed_logs(draw, messages):
    """A log with one to three faults in its messages."""
    messages = list(messages)
    for _ in range(draw(st.integers(1, 3))):
        topic = draw(st.sampled_from(sorted({message.channel.topic for message in messages})))
        at = draw(st.sampled_from([k for k, message in enumerate(messages) if message.channel.topic == topic]))
        how = draw(st.sampled_from(("data", "data", "data", "data", "channel", "time", "order", "repeat")))
        if how == "data":
            messages[at] = replace(messages[at], data=draw(changed_data(messages[at])))
        elif how == "time":
            messages[at] = replace(messages[at], log_time_ns=draw(integers(64)))
        elif how == "order":
            messages = messages[at:] + messages[:at]
        elif how == "repeat":
            messages[at:at] = [messages[at]] * 50
        else:
            new, old = draw(changed_channel(messages[at].channel)), messages[at].channel
            messages = [replace(m, channel=new) if m.channel == old else m for m in messages]
    return bases.log_of(messages)


@examples
@given(st.data(), st.sampled_from(sorted(bases.MESSAGES)), COMMANDS)
def test_messages_of_a_log(data, base, command):
    with folder_of({"in.mcap": data.draw(changed_logs(bases.MESSAGES[base]()))}) as folder:
        require_clear_end(folder, *command.split())


@examples
@given(st.data(), OF_RESULTS)
def test_messages_of_a_result(data, command):
    with folder_of({"in.mcap": bases.results()["out.mcap"]}) as folder:
        messages = bases.messages_of(folder / "in.mcap")
        (folder / "in.mcap").write_bytes(data.draw(changed_logs(messages)))
        require_clear_end(folder, *command.split())
