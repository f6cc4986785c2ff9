"""Lengths in pixels: given for one image height, used at any."""

from typing import Final

_CONFIG_ROWS: Final = 960.0


def scaled(length_px: float, rows: int) -> float:
    """A length of the configuration, given at 960 image rows, in an image of so many rows."""
    return length_px * rows / _CONFIG_ROWS
