"""What a message asks for, held against the limits; pixels are counted where they are decoded."""

from typing import Final, Literal

from roadperc_stream.core.config import LimitsConfig
from roadperc_stream.core.geometry import Camera
from roadperc_stream.errors import DecodeError
from roadperc_stream.formats.images import require_pixels
from roadperc_stream.input.decoding.payload import Payload, names_in
from roadperc_stream.schemas.roles import Kind

_LARGE: Final[frozenset[Kind]] = frozenset(("image", "tags", "instances", "depth", "points"))
"""Kinds whose messages are read as a whole; those of others item by item."""


def require_length(kind: Kind, data: bytes, limits: LimitsConfig) -> None:
    """Refuse a message that would take long to read.

    Raises:
        DecodeError: the message names the limit.
    """
    if len(data) > limits.message_bytes and kind not in _LARGE:
        raise DecodeError(f"{len(data)} bytes: expected limits.message_mb {limits.message_mb} at most")


def require_count(items: Literal["points", "detections", "transforms"], found: int, limits: LimitsConfig) -> None:
    """Refuse more items than a message may have.

    Raises:
        DecodeError: the message names the limit.
    """
    most: int = getattr(limits, items)
    if found > most:
        raise DecodeError(f"{found} {items}: expected limits.{items} {most} at most")


def require_within(payload: Payload, limits: LimitsConfig) -> None:
    """Refuse a camera that is too large, and a name that is too long.

    Raises:
        DecodeError: the message names the limit.
    """
    if isinstance(payload, Camera):
        require_pixels("calibration", payload.width, payload.height, limits)
    longest = max(map(len, names_in(payload)), default=0)
    if longest > limits.name_length:
        raise DecodeError(f"a name of {longest} characters: expected limits.name_length {limits.name_length} at most")
