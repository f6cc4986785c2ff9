"""The stages by name, for those who need no more than that."""

from typing import Final

STAGES: Final = ("stereo", "surface", "odometry", "lanes", "objects", "occupancy")
"""Stages in the order in which they run; each has a section in the configuration."""
NEEDS: Final = {"odometry": ("surface",), "lanes": ("surface",), "occupancy": ("surface",)}
"""What stages need of others: odometry without depth has its scale from the road."""


def switched_off(stage: str) -> str:
    """The setting that switches a stage off."""
    return "stereo.method=off" if stage == "stereo" else f"{stage}.enabled=false"
