"""ROS 2 message definitions as a log carries them, held to what can be read in reasonable time.

The reader of a message is code that is generated from the definition, with every item of a fixed array of strings or
messages unrolled: a line of text could ask for gigabytes of it. Of IDL, brackets and sequences within one another take
the parser a time that grows exponentially with their depth.
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
"""The largest of the messages that ROS 2 Jazzy brings has 119, and 4 kB of text without its comments."""
DEEPEST: Final = 50
_LONGEST_ARRAY: Final = 2**31 - 1
_SEPARATOR: Final = "=" * 80 + "\n"
_IDL_TEXT: Final = re.compile(r'"(?:\\"|[^"])*"|/\*.*?\*/|//[^\n]*', re.DOTALL)
_IDL_ANNOTATION: Final = re.compile(r"@\s*[\w:]+\s*\(")
_IDL_COMPUTED: Final = re.compile(r"[(*]|<<|sequence\s*<\s*sequence\b")


def types_of(name: str, definition: bytes, encoding: str) -> Typesdict:
    """The types that a definition speaks of, ``name`` among them.

    Args:
        name: the message's type, such as ``sensor_msgs/msg/Image``.
        definition: text of the type and of those it is made of.
        encoding: ``ros2msg`` or ``ros2idl``.

    Raises:
        DecodeError: the type or one it needs is not defined, is made of itself, or is beyond the bounds.
        Exception: what the parser meets in a text that is no definition.
    """
    if len(definition) > MOST_BYTES:
        raise DecodeError(f"{len(definition)} bytes: expected {MOST_BYTES} at most")
    text = definition.decode()
    if encoding == "ros2msg":
        types = get_types_from_msg(text, name)
    elif encoding == "ros2idl":
        types = {key: value for part in _idl_parts(text) for key, value in get_types_from_idl(part).items()}
    else:
        raise DecodeError(f"is defined in {encoding or 'no language'}: expected ros2msg or ros2idl")
    stated = sum(len(constants) + len(fields) for constants, fields in types.values())
    if stated > MOST_ELEMENTS:
        raise DecodeError(f"{stated} fields and constants: expected {MOST_ELEMENTS} at most")
    _count(name, types, ())
    return types


def _idl_parts(text: str) -> Iterator[str]:
    """One definition a type: rosbag2 puts a rule and a line with the type's name before each."""
    for part in text.split(_SEPARATOR):
        if part.strip():
            idl = part.partition("\n")[2] if part.startswith("IDL: ") else part
            _require_plain(idl)
            yield idl


def _require_plain(idl: str) -> None:
    """ROS 2 writes constants as plain numbers and no sequence within another."""
    found = _IDL_COMPUTED.search(_IDL_ANNOTATION.sub(" ", _IDL_TEXT.sub(" ", idl)))
    if found is not None:
        raise DecodeError(f"{found[0]!r} in the IDL: expected plain constants, and no sequence of sequences")


def _count(name: str, types: Typesdict, within: tuple[str, ...]) -> int:
    """What is read one by one for a message of this type: fields, those of the messages in it and in fixed arrays."""
    if name not in types:
        raise DecodeError(f"lacks {name!r}")
    if name in within:
        raise DecodeError(f"{name} is made of itself")
    if len(within) >= DEEPEST:
        raise DecodeError(f"types within types: expected {DEEPEST} levels at most")
    number = 1
    for field, kind in types[name][1]:
        number += _count_field(f"{name}.{field}", kind, types, (*within, name))
        # Counted up to here only: types within types multiply, and looking at them all would take as long as reading.
        if number > MOST_ELEMENTS:
            raise DecodeError(f"{name} has more than {MOST_ELEMENTS} elements, fixed arrays multiplied out")
    return number


def _count_field(field: str, kind: FieldDesc, types: Typesdict, within: tuple[str, ...]) -> int:
    if kind[0] == Nodetype.BASE:
        return 1
    if kind[0] == Nodetype.NAME:
        return _count(str(kind[1]), types, within)
    item, length = kind[1]
    fixed = kind[0] == Nodetype.ARRAY
    if fixed and not 1 <= int(length) <= _LONGEST_ARRAY:
        raise DecodeError(f"{field} is an array of {brief(length)}")
    each = _count(str(item[1]), types, within) if item[0] == Nodetype.NAME else 1
    unrolled = fixed and (item[0] == Nodetype.NAME or item[1][0] == "string")
    return each * int(length) if unrolled else each


def brief(words: object) -> str:
    """One line of at most 200 characters of what somebody else's code says."""
    line = " ".join(str(words).split())
    return line if len(line) <= 200 else f"{line[:199]}…"
