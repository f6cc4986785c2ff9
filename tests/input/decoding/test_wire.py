"""Messages whose one large field is not copied: the same as a parser gives, of any bytes."""

import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.input.decoding.wire import parsed

WHOLE = CompressedImage(frame_id="camera", data=b"pixels" * 100, format="png")
WHOLE.timestamp.seconds, WHOLE.timestamp.nanos = 1_600_000_000, 5
DATA = WHOLE.SerializeToString()
FIELDS = (b"\x0a\x02\x08\x05", b"\x22\x01a", b"\x1a\x00", b"\x12\x03abc", b"\x12\x00", b"\x50\x96\x01", b"\x5d1234")
BROKEN = (b"\x22\x01\xff", b"\x12\x7fab", b"\x0b", b"\x02\x01", b"\x0a\x01\xff", b"\x80" * 12)


def as_parser(message_type, data):
    try:
        message = message_type.FromString(data)
    except DecodeError:
        return None
    content = message.data
    message.ClearField("data")
    return message.SerializeToString(), content


def as_parsed(message_type, data):
    try:
        message, content = parsed(message_type, data, "data")
    except DecodeError:
        return None
    content = bytes(content)
    message.ClearField("data")
    return message.SerializeToString(), content


def test_the_content_is_not_copied():
    message, content = parsed(CompressedImage, DATA, "data")
    assert isinstance(content, memoryview)
    assert content.obj is DATA
    assert content == WHOLE.data
    assert (message.frame_id, message.timestamp, message.format, message.data) == (
        "camera",
        WHOLE.timestamp,
        "png",
        b"",
    )


@pytest.mark.parametrize("end", range(0, len(DATA), 7))
def test_the_parser_reports_cut_messages(end):
    assert as_parsed(CompressedImage, DATA[:end]) == as_parser(CompressedImage, DATA[:end])


@given(st.lists(st.sampled_from(FIELDS + BROKEN), max_size=40).map(b"".join))
def test_fields_in_any_order_again_unknown_or_broken(data):
    assert as_parsed(CompressedImage, data) == as_parser(CompressedImage, data)


@given(st.binary(max_size=40))
def test_any_bytes(data):
    for message_type in (CompressedImage, RawImage):
        assert as_parsed(message_type, data) == as_parser(message_type, data)


def test_a_message_without_the_field_has_none():
    message, content = parsed(CompressedImage, CompressedImage(frame_id="camera").SerializeToString(), "data")
    assert (message.frame_id, bytes(content)) == ("camera", b"")
