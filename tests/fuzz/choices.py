"""Choices that are given by a recipe or drawn at random, and recorded; random damage to bytes."""

import random
import struct
from collections.abc import Callable, Sequence
from typing import Any

INTEGERS = (
    0, 1, 2, 3, 7, 8, 31, 127, 128, 255, 256, 4095, 32767, 32768, 65535, 65536, 10**6, 2**24, 2**31 - 1, 2**31,
    2**32 - 1, 2**32, 10**10, 2**53, 2**63 - 1, 2**63, 2**64 - 1, -1, -2, -32768, -(2**31), -(2**63),
)  # fmt: skip
FLOATS = (
    float("nan"), float("inf"), float("-inf"), 0.0, -0.0, 1.0, -1.0, 0.5, 1e-9, 5e-324, 1e9, 1e18, 1e30, 3e38, 1e300,
    1e308, -1e308, 1.7976931348623157e308, -1e-300, 4294967296.0, 1e5, 32.0, 24.0, 1e-3,
)  # fmt: skip
INJECTED = "INJECTED"
"""Names contain it after a newline; no printed line may start with it."""
TEXTS = (
    "", " ", "\n", "\r", "\t", "\x00", "/a/b", "/", "../x", "ego", "camera", "map", "png", "jpeg", "rgb8", "bgra8",
    "16UC1", "32FC1", "mono16", "bayer_rggb8", "zstd", "lz4", "protobuf", "cdr", "json", "nan", "None", "auto",
    "0.9.15",
    "\x1b[31mred\x1b[0m", "\x1b]0;title\x07", "\x9b2J", f"/a\n{INJECTED}", f"/a\r{INJECTED}", f"/a\u2028{INJECTED}",
    "\u202etxt", "[bold]b[/bold]", "[/nope]", "[red", "%s%d%n", "{0}{x}", "äöü", "\U0001f600", "x" * 300,
    "y" * 20_000, "C:\\a", "'; --", '"', "\\", "<script>alert(1)</script>", "/camera/front/image", "/tf",
)  # fmt: skip


class Choices:
    """Named choices, in a tree that can be written as JSON.

    Args:
        given: choices of a recipe; missing choices are drawn.
        numbers: the random numbers.
    """

    def __init__(self, given: dict[str, Any] | None, numbers: random.Random) -> None:
        self._given = given or {}
        self._is_given = given is not None
        self._numbers = numbers
        self.made: dict[str, Any] = {}

    def of(self, name: str, options: Sequence[Any]) -> Any:
        """One of the options, with equal probability."""
        return self._noted(name, lambda: self._numbers.choice(options))

    def number(self, name: str, low: int, high: int) -> int:
        """A whole number from `low` to `high`."""
        return int(self._noted(name, lambda: self._numbers.randint(low, high)))

    def share(self, name: str) -> float:
        """A number from 0 to 1, such as the position of a byte in a file."""
        return float(self._noted(name, lambda: round(self._numbers.random(), 6)))

    def index(self, name: str, count: int) -> int:
        """An index below `count`; a given index is taken modulo `count`."""
        return int(self._noted(name, lambda: self._numbers.randrange(count))) % count

    def chance(self, name: str, probability: float) -> bool:
        """True with this probability."""
        return bool(self._noted(name, lambda: self._numbers.random() < probability))

    def part(self, name: str) -> "Choices":
        """Nested choices below a name."""
        inner = Choices(self._given.get(name), self._numbers)
        self.made[name] = inner.made
        return inner

    def parts(self, name: str, most: int) -> "list[Choices]":
        """A list of nested choices: those of the recipe (empty if it has none), else at most `most`."""
        given = self._given.get(name, []) if self._is_given else [None] * self._numbers.randint(0, most)
        inner = [Choices(item, self._numbers) for item in given]
        self.made[name] = [item.made for item in inner]
        return inner

    def _noted(self, name: str, draw: Any) -> Any:
        assert name not in self.made, f"{name} is chosen twice, so a recipe could not repeat it"
        self.made[name] = self._given[name] if name in self._given else draw()
        return self.made[name]


def wild_integer(choices: Choices, name: str = "value") -> int:
    """An integer, often at the limit of a type."""
    return int(choices.of(name, INTEGERS))


def wild_float(choices: Choices, name: str = "value") -> float:
    """An unusual float."""
    return float(choices.of(name, FLOATS))


def wild_text(choices: Choices, name: str = "value") -> str:
    """An unusual text."""
    return str(choices.of(name, TEXTS))


def wild_like(before: Any, choices: Choices) -> Any:
    """An unusual value of the same type."""
    if isinstance(before, bytes):
        return damage(before, choices.part("damage"))
    if isinstance(before, bool):
        return not before
    if isinstance(before, str):
        return wild_text(choices)
    return wild_float(choices) if isinstance(before, float) else wild_integer(choices)


MOST_COPIED = 4096


def damage(data: bytes, choices: Choices) -> bytes:
    """The bytes with one fault; they grow by a few thousand bytes at most."""
    fault = FAULTS[choices.of("fault", tuple(FAULTS))]
    at = int(choices.share("at") * len(data))
    end, new = fault(data, at, choices)
    return data[:at] + new + data[end:]


def _overwritten(_: bytes, at: int, choices: Choices) -> tuple[int, bytes]:
    layout, value = choices.of("layout", ("<H", "<I", "<Q", ">I", "<d")), wild_integer(choices)
    size = struct.calcsize(layout)
    return at + size, struct.pack(layout, float(value) if layout == "<d" else value % (1 << (8 * size)))


def _swapped(data: bytes, at: int, choices: Choices) -> tuple[int, bytes]:
    length = choices.number("length", 1, 64)
    other = at + length + int(choices.share("other") * max(len(data) - at - 2 * length, 0))
    end = other + length
    return end, data[other:end] + data[at + length : other] + data[at : at + length]


FAULTS: dict[str, Callable[[bytes, int, Choices], tuple[int, bytes]]] = {
    "flip": lambda d, at, c: (at + 1, bytes(byte ^ 1 << c.number("bit", 0, 7) for byte in d[at : at + 1])),
    "set": lambda _, at, c: (at + 1, bytes([c.of("byte", (0, 1, 0x0A, 0x1B, 0x7F, 0x80, 0xFE, 0xFF))])),
    "cut": lambda d, _at, _c: (len(d), b""),
    "remove": lambda _, at, c: (at + c.number("length", 1, 64), b""),
    "repeat": lambda d, at, c: (at, d[at : at + c.number("length", 1, MOST_COPIED)]),
    "insert": lambda _, at, c: (at, c.number("length", 1, 64) * bytes([c.of("byte", (0, 0x20, 0x41, 0xFF))])),
    "overwrite": _overwritten,
    "swap": _swapped,
}
"""Each returns the end of the replaced bytes, and the new bytes."""
