"""Parses the ROS message definitions of a log, within limits on their size.

The library generates code from a definition, and unrolls every item of a fixed array of strings or messages. One line
of text could need gigabytes of code.
"""

from collections.abc import Iterator
from typing import Final

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from roadperc_stream.errors import DecodeError

MOST_BYTES: Final = 100_000
MOST_ELEMENTS: Final = 1000
"""The largest message of ROS 2 Jazzy has 119, and 4 kB of text without comments."""
_SEPARATOR: Final = "=" * 80 + "\n"
_BUILT_IN: Final = (
    f"\n{_SEPARATOR}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    f"{_SEPARATOR}MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n"
)
"""Types that ROS 1 does not define in a bag."""
_HEADER: Final = get_types_from_msg("builtin_interfaces/Time stamp\nstring frame_id\n", "std_msgs/msg/Header")
"""ROS 2 has no sequence number in the header."""


def types_of(name: str, definition: bytes, encoding: str) -> Typesdict:
    """Return the types in a definition, including ``name``.

    ``name`` is a type such as ``sensor_msgs/msg/Image``; ``definition`` is its text with the types that it contains.
    ``encoding`` is ``ros2msg``, ``ros2idl``, or ``ros1msg``, whose types are returned as those of ROS 2: with names of
    fields in lower case only.

    Raises:
        DecodeError: the type or one that it contains is undefined, contains itself, or exceeds the limits.
        Exception: any error of the parser, for a text that is not a definition.
    """
    if len(definition) > MOST_BYTES:
        raise DecodeError(f"{len(definition)} bytes: expected {MOST_BYTES} at most")
    text = definition.decode()
    if encoding == "ros2msg":
        types = get_types_from_msg(text, name)
    elif encoding == "ros1msg":
        found = get_types_from_msg(text + _BUILT_IN, name)
        types = {key: (said, [(f.lower(), kind) for f, kind in fields]) for key, (said, fields) in found.items()}
        types |= _HEADER
    elif encoding == "ros2idl":
        types = {key: value for part in _idl_parts(text) for key, value in get_types_from_idl(part).items()}
    else:
        raise DecodeError(f"definition in encoding {encoding or 'none'}: expected ros2msg, ros2idl or ros1msg")
    stated = sum(len(constants) + len(fields) for constants, fields in types.values())
    if stated > MOST_ELEMENTS:
        raise DecodeError(f"{stated} fields and constants: expected {MOST_ELEMENTS} at most")
    _require_few(name, types, ())
    return types


def _idl_parts(text: str) -> Iterator[str]:
    """Yield the definition of each type: rosbag2 writes a rule and a line with the type's name before each."""
    for part in text.split(_SEPARATOR):
        if part.strip():
            yield part.partition("\n")[2] if part.startswith("IDL: ") else part


def _require_few(name: str, types: Typesdict, within: tuple[str, ...]) -> int:
    """Return the number of values that are read one by one: all fields, with fixed arrays multiplied out."""
    if name not in types:
        raise DecodeError(f"type {name!r} is not defined")
    if name in within:
        raise DecodeError(f"{name} contains itself")
    number = 1
    for _, kind in types[name][1]:
        item, length = (kind, 1) if kind[0] == Nodetype.BASE or kind[0] == Nodetype.NAME else kind[1]
        is_message = item[0] == Nodetype.NAME
        unrolled = kind[0] == Nodetype.ARRAY and (is_message or item[1][0] == "string")
        each = _require_few(str(item[1]), types, (*within, name)) if is_message else 1
        number += each * int(length) if unrolled else each
        # stop here: nested types multiply, and counting all of them would take too long
        if number > MOST_ELEMENTS:
            raise DecodeError(f"{name} has too many elements: expected {MOST_ELEMENTS} at most")
    return number


def brief(text: object) -> str:
    """Return a library's text as one line of at most 200 characters."""
    line = " ".join(str(text).split())
    return line if len(line) <= 200 else f"{line[:199]}…"
