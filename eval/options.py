"""Choices that a command line offers, by name alone: what they mean stands where they are used."""

from typing import Final, Literal

Alignment = Literal["se3", "sim3", "origin", "none"]
"""How an estimated path is aligned to the true one."""
DeltaUnit = Literal["frames", "metres"]
LanePairing = Literal["stamp", "order"]
"""How a true lane frame finds its own."""
WORST_FRAMES: Final = 3
