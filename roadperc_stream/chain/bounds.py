"""Limits on the contents of an encoded state, checked before the state is decoded."""

from dataclasses import dataclass
from typing import Final, NamedTuple

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import StateError

ARRAY_DATA_KEY: Final = b"elements"
"""The key of an array's bytes."""
_LEAST_ITEMS: Final = 1_000_000
_ITEMS_PER_TRANSFORM: Final = 500
"""An edge has 16 items. Each pending frame may hold its own transform tree."""
_ITEMS_PER_DETECTION: Final = 64
_BYTES_PER_PIXEL: Final = 4
_MOST_NESTED: Final = 64
"""Levels of lists and maps. Python's own limit depends on the thread, and so would the result."""
TOO_NESTED: Final = f"nested more than {_MOST_NESTED} levels deep"


@dataclass(frozen=True)
class StateBounds:
    """The most keys and values of a state together, and the most bytes of one array."""

    items: int
    array_bytes: int

    @classmethod
    def of(cls, limits: LimitsConfig) -> "StateBounds":
        """The bounds for messages within the limits. The largest array is a depth image."""
        per_message = _ITEMS_PER_TRANSFORM * limits.transforms + _ITEMS_PER_DETECTION * limits.detections
        return cls(_LEAST_ITEMS + per_message, _BYTES_PER_PIXEL * limits.image_pixels + limits.message_bytes)


DEFAULT_BOUNDS: Final = StateBounds.of(DEFAULT_LIMITS)


class _Kind(NamedTuple):
    """The layout of an item after its first byte: its length, then ``more_bytes``, then ``more_items``.

    Each unit of the length stands for ``items_each`` items, or for one byte if that is 0.
    """

    length_bytes: int = 0
    more_bytes: int = 0
    more_items: int = 0
    items_each: int = 0


def require_bounded(plain: bytes, bounds: StateBounds) -> None:
    """Check the declared numbers of items and array bytes, and the depth. The decoder reports truncated MessagePack.

    Raises:
        StateError: more than the bounds allow.
    """
    kinds, most, size = _KINDS, bounds.items, len(plain)
    at, start, pending, done = 0, 0, 1, 0
    ends: list[int] = []  # of the lists and maps around the item: the number of pending items behind them
    while pending and at < size:
        while ends and pending <= ends[-1]:
            ends.pop()
        before, start = start, at
        length_bytes, more_bytes, more_items, items_each = kinds[plain[at]]
        at += 1 + more_bytes
        pending += more_items - 1
        done += 1
        if more_items:
            ends.append(pending - more_items)
        if length_bytes:
            length = int.from_bytes(plain[start + 1 : start + 1 + length_bytes], "big")
            at += length_bytes + (0 if items_each else length)
            pending += length * items_each
            if items_each:
                ends.append(pending - length * items_each)
            if length > bounds.array_bytes and plain[before:start].endswith(ARRAY_DATA_KEY):
                raise StateError(f"array of {length} bytes: expected {bounds.array_bytes} at most")
        if len(ends) > _MOST_NESTED:
            raise StateError(TOO_NESTED)
        if done + pending > most:
            raise StateError(f"more than {most} items: expected {most} at most")


def _kinds() -> tuple[_Kind, ...]:
    """The kind of each first byte, from the MessagePack specification."""
    kinds = [_Kind()] * 256  # small integers, nil and truth values are one byte
    for n in range(16):
        kinds[0x80 + n] = _Kind(more_items=2 * n)
        kinds[0x90 + n] = _Kind(more_items=n)
    for n in range(32):
        kinds[0xA0 + n] = _Kind(more_bytes=n)
    for k, length_bytes in enumerate((1, 2, 4)):
        kinds[0xC4 + k] = kinds[0xD9 + k] = _Kind(length_bytes)  # bytes, text
        kinds[0xC7 + k] = _Kind(length_bytes, more_bytes=1)  # extensions
    for k, length_bytes in enumerate((2, 4)):
        kinds[0xDC + k] = _Kind(length_bytes, items_each=1)  # arrays
        kinds[0xDE + k] = _Kind(length_bytes, items_each=2)  # maps
    kinds[0xCA], kinds[0xCB] = _Kind(more_bytes=4), _Kind(more_bytes=8)  # floats
    for k in range(4):
        kinds[0xCC + k] = kinds[0xD0 + k] = _Kind(more_bytes=2**k)  # integers
    for k in range(5):
        kinds[0xD4 + k] = _Kind(more_bytes=2**k + 1)  # extensions of fixed length
    return tuple(kinds)


_KINDS: Final = _kinds()
