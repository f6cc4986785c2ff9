"""Parses the ROS message definitions of a log, within limits on their size.

The library generates code from a definition, and unrolls every item of a fixed array of strings or messages. One line
of text could need gigabytes of code. Nested brackets and sequences in IDL take the parser exponential time.
"""

import re
from collections.abc import Iterator
from typing import Final

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from roadperc_stream.errors import DecodeError

MOST_BYTES: Final = 100_000
MOST_ELEMENTS: Final = 1000
"""The largest message of ROS 2 Jazzy has 119, and 4 kB of text without comments."""
DEEPEST: Final = 50
_LONGEST_ARRAY: Final = 2**31 - 1
_SEPARATOR: Final = "=" * 80 + "\n"
_BUILT_IN: Final = (
    f"\n{_SEPARATOR}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    f"{_SEPARATOR}MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n"
)
"""Types that ROS 1 does not define in a bag."""
_HEADER: Final = get_types_from_msg("builtin_interfaces/Time stamp\nstring frame_id\n", "std_msgs/msg/Header")
"""ROS 2 has no sequence number in the header."""
_IDL_TEXT: Final = re.compile(r'"(?:\\"|[^"])*"|/\*.*?\*/|//[^\n]*', re.DOTALL)
_IDL_ANNOTATION: Final = re.compile(r"@\s*[\w:]+\s*\(")
_IDL_COMPUTED: Final = re.compile(r"[(*]|<<|sequence\s*<\s*sequence\b")


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
    _count(name, types, ())
    return types


def _idl_parts(text: str) -> Iterator[str]:
    """Yield the definition of each type: rosbag2 writes a rule and a line with the type's name before each."""
    for part in text.split(_SEPARATOR):
        if part.strip():
            idl = part.partition("\n")[2] if part.startswith("IDL: ") else part
            _require_plain(idl)
            yield idl


def _require_plain(idl: str) -> None:
    """Refuse computed constants and sequences of sequences, which ROS 2 does not write."""
    found = _IDL_COMPUTED.search(_IDL_ANNOTATION.sub(" ", _IDL_TEXT.sub(" ", idl)))
    if found is not None:
        raise DecodeError(f"{found[0]!r} in the IDL: expected plain constants and no nested sequences")


def _count(name: str, types: Typesdict, within: tuple[str, ...]) -> int:
    """Return the number of values that are read one by one: all fields, with fixed arrays multiplied out."""
    if name not in types:
        raise DecodeError(f"type {name!r} is not defined")
    if name in within:
        raise DecodeError(f"{name} contains itself")
    if len(within) >= DEEPEST:
        raise DecodeError(f"nested types: expected {DEEPEST} levels at most")
    number = 1
    for field, kind in types[name][1]:
        number += _count_field(f"{name}.{field}", kind, types, (*within, name))
        # stop here: nested types multiply, and counting all of them would take too long
        if number > MOST_ELEMENTS:
            raise DecodeError(f"{name} has too many elements: expected {MOST_ELEMENTS} at most")
    return number


def _count_field(field: str, kind: FieldDesc, types: Typesdict, within: tuple[str, ...]) -> int:
    if kind[0] == Nodetype.BASE:
        return 1
    if kind[0] == Nodetype.NAME:
        return _count(str(kind[1]), types, within)
    item, length = kind[1]
    fixed = kind[0] == Nodetype.ARRAY
    if fixed and not 1 <= int(length) <= _LONGEST_ARRAY:
        raise DecodeError(f"{field} is an array of length {brief(length)}: expected 1 to {_LONGEST_ARRAY}")
    each = _count(str(item[1]), types, within) if item[0] == Nodetype.NAME else 1
    if not fixed and _is_empty(item, types):
        raise DecodeError(f"{field} is a sequence of items without fields")  # a few bytes could claim 2^32 of them
    unrolled = fixed and (item[0] == Nodetype.NAME or item[1][0] == "string")
    return each * int(length) if unrolled else each


def _is_empty(kind: FieldDesc, types: Typesdict) -> bool:
    """Whether a field takes no bytes."""
    if kind[0] == Nodetype.NAME:
        return all(_is_empty(part, types) for _, part in types[str(kind[1])][1])
    return kind[0] == Nodetype.ARRAY and _is_empty(kind[1][0], types)


def brief(text: object) -> str:
    """Return a library's text as one line of at most 200 characters."""
    line = " ".join(str(text).split())
    return line if len(line) <= 200 else f"{line[:199]}…"
