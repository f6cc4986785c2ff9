"""Definitions of ROS 2 messages that no log should carry: refused at once, in a line."""

import numpy as np
import pytest

from roadperc_stream.errors import DecodeError
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.schemas import cdr, ros2
from roadperc_stream.schemas.definitions import MOST_BYTES, MOST_ELEMENTS, types_of

RULE = "=" * 80 + "\n"
NAME = "demo/msg/Thing"
HEADER = b"\x00\x01\x00\x00"


def parts(*more):
    return "".join(f"{RULE}MSG: {name}\n{text}\n" for name, text in more)


def idl(members="long a;", constants=""):
    return f"module demo {{ module msg {{ {constants} struct Thing {{ {members} }}; }}; }};"


def refusal(definition, encoding="ros2msg"):
    with pytest.raises(DecodeError) as refused:
        cdr.read(HEADER + bytes(64), NAME, definition.encode(), encoding)
    text = str(refused.value)
    assert text.startswith(f"the log's definition of {NAME} cannot be read: ")
    assert "\n" not in text
    assert len(text) < 300
    return text


TWICE = [(f"demo/T{k}", f"demo/T{k + 1} one\ndemo/T{k + 1} two") for k in range(20)]


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        ("string[200000] a\n", f"demo/msg/Thing has too many elements: expected {MOST_ELEMENTS} at most"),
        ("demo/Row[40] a\n" + parts(("demo/Row", "string[40] b")), "has too many elements"),
        ("demo/T0 a\n" + parts(*TWICE, ("demo/T20", "int8 x")), "has too many elements"),
        ("".join(f"uint8 a{k}\n" for k in range(3000)), f"fields and constants: expected {MOST_ELEMENTS}"),
        ("#" * 200_000 + "\nuint8 a\n", f"200009 bytes: expected {MOST_BYTES} at most"),
        ("demo/Thing a\n", "demo/msg/Thing contains itself"),
        ("demo/Thing[] a\n", "demo/msg/Thing contains itself"),
        ("demo/Other a\n" + parts(("demo/Other", "demo/Thing b")), "demo/msg/Thing contains itself"),
        ("float32 B=1e999\nuint8 a\n", "inf"),
        ("uint8 a\nuint8 a\n", "conflicting"),
        ("demo/Missing a\n", "type 'demo/msg/Missing' is not defined"),
        ("(" * 5000, "Could not parse"),
    ],
    ids=lambda value: value[:16].replace("\n", " "),
)
@pytest.mark.parametrize("encoding", ["ros2msg", "ros1msg"])
def test_invalid_or_huge_definitions_are_refused(definition, words, encoding):
    assert words in refusal(definition, encoding)


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        (idl("demo::msg::Thing a;"), "demo/msg/Thing contains itself"),
        ("module demo { " * 500, "recursion"),
        ("struct {" * 500, "Could not parse"),
    ],
    ids=["itself", "modules", "text"],
)
def test_idl_that_is_no_definition_is_refused(definition, words):
    assert words in refusal(definition, "ros2idl")


def test_idl_of_ros_2_is_read():
    text = idl(
        '@verbatim (language="comment", text="a (b * c) << 2")\n@default (value=-1) long a; double b[3];  // (*\n'
    )
    found = cdr.read(HEADER + bytes(32), NAME, text.encode(), "ros2idl")
    assert found.a == 0
    np.testing.assert_array_equal(found.b, np.zeros(3))


def test_long_arrays_of_numbers_are_one_element():
    constants, fields = types_of(NAME, b"float64[2000000] a\nstring[900] b\n", "ros2msg")[NAME]
    assert not constants
    assert [name for name, _ in fields] == ["a", "b"]


@pytest.mark.parametrize("data", [b"", HEADER, HEADER + bytes(3), b"\x00\x07" + bytes(40)])
def test_bytes_of_another_layout_are_an_error(data):
    with pytest.raises(DecodeError, match=f"{len(data)} bytes are not a valid {NAME}: "):
        cdr.read(data, NAME, b"float64 a\nstring b\n")


@pytest.mark.parametrize(
    ("fields", "size"),
    [
        (b"uint8[19] a\n", 19),
        (b"string[] height\nstring[] width\nuint32 step\nstring[] encoding\nuint8[] data\nuint8 is_bigendian\n", 24),
    ],
    ids=["none", "others"],
)
def test_a_type_with_the_fields_of_another_is_an_error(fields, size):
    _, rule, others = ros2.IMAGE_DEFINITION.partition(b"=")
    definition = b"std_msgs/Header header\n" + fields + rule + others
    header = bytes(8) + b"\x01\x00\x00\x00" + b"\x00"
    with pytest.raises(DecodeError, match=f"{ros2.IMAGE} as the log defines it: "):
        decode("image", ros2.IMAGE, "cdr", HEADER + header + bytes(size), 1, Context(None, definition))
