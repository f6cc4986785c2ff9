"""Fields of messages: those that may be absent, and numbers that must be some."""

from typing import Any, Final

import numpy as np

from roadperc_stream.errors import DecodeError

_LARGEST: Final = float(np.finfo(np.float32).max)


def require_finite(what: str, *values: float | None) -> None:
    """Refuse numbers that are none; unknown ones are None.

    Raises:
        DecodeError: one is NaN, infinite, or larger than the 32 bits hold in which it is computed with and shown.
    """
    if not all(abs(value) <= _LARGEST for value in values if value is not None):
        raise DecodeError(f"{what}: a number is not finite in 32 bits")


def optional(message: Any, name: str) -> Any:
    """A field of a protobuf message; None where it is not set."""
    return getattr(message, name) if message.HasField(name) else None
