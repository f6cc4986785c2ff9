"""Bytes changed without knowing what they mean."""

import struct
from collections.abc import Callable

from tests.fuzz.choices import Choices, wild_integer

MOST_COPIED = 4096


def damage(data: bytes, choices: Choices) -> bytes:
    """The bytes with one fault; none can get longer by more than a few thousand."""
    fault: Callable[[bytearray, Choices], None] = FAULTS[choices.of("fault", tuple(FAULTS))]
    changed = bytearray(data)
    fault(changed, choices)
    return bytes(changed)


def _at(data: bytearray, choices: Choices) -> int:
    return int(choices.share("at") * len(data))


def _flip(data: bytearray, choices: Choices) -> None:
    at, bit = _at(data, choices), choices.number("bit", 0, 7)
    if data:
        data[at] ^= 1 << bit


def _set(data: bytearray, choices: Choices) -> None:
    at, value = _at(data, choices), choices.of("byte", (0, 1, 0x0A, 0x1B, 0x7F, 0x80, 0xFE, 0xFF))
    if data:
        data[at] = value


def _cut(data: bytearray, choices: Choices) -> None:
    del data[_at(data, choices) :]


def _remove(data: bytearray, choices: Choices) -> None:
    at = _at(data, choices)
    del data[at : at + choices.number("length", 1, 64)]


def _repeat(data: bytearray, choices: Choices) -> None:
    at, length = _at(data, choices), choices.number("length", 1, MOST_COPIED)
    data[at:at] = data[at : at + length]


def _insert(data: bytearray, choices: Choices) -> None:
    at, length = _at(data, choices), choices.number("length", 1, 64)
    data[at:at] = bytes([choices.of("byte", (0, 0x20, 0x41, 0xFF))]) * length


def _overwrite(data: bytearray, choices: Choices) -> None:
    at, layout, value = _at(data, choices), choices.of("layout", ("<H", "<I", "<Q", ">I", "<d")), wild_integer(choices)
    if layout == "<d":
        packed = struct.pack(layout, float(value))
    else:
        packed = struct.pack(layout, value % (1 << (8 * struct.calcsize(layout))))
    data[at : at + len(packed)] = packed


def _swap(data: bytearray, choices: Choices) -> None:
    half = len(data) // 2
    length = choices.number("length", 1, 64)
    first = int(choices.share("at") * half)
    second = half + int(choices.share("other") * half)
    data[first : first + length], data[second : second + length] = (
        data[second : second + length], data[first : first + length],
    )  # fmt: skip


FAULTS = {
    "flip": _flip, "set": _set, "cut": _cut, "remove": _remove, "repeat": _repeat, "insert": _insert,
    "overwrite": _overwrite, "swap": _swap,
}  # fmt: skip
