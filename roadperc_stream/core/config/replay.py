"""The whole configuration of a replay."""

from typing import Annotated

import tomli_w
from pydantic import Field

from roadperc_stream.core.config.fields import Section, TableName
from roadperc_stream.core.config.stages import (
    LanesConfig,
    ObjectsConfig,
    OccupancyConfig,
    OdometryConfig,
    StereoConfig,
    SurfaceConfig,
    SyncConfig,
)

STAGES = ("stereo", "surface", "odometry", "lanes", "objects", "occupancy")
"""Stages in the order in which they run; each has a section below."""
NEEDS = {"odometry": ("surface",), "lanes": ("surface",), "occupancy": ("surface",)}
"""What stages need of others: odometry without depth has its scale from the road."""


def switched_off(stage: str) -> str:
    """The setting that switches a stage off."""
    return "stereo.method=off" if stage == "stereo" else f"{stage}.enabled=false"


class ReplayConfig(Section):
    """Everything that decides what a replay computes."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    tag_table: TableName = "auto"
    """Tag table of logs that do not name theirs: a CARLA version, a table's name, or ``auto`` (what the log says)."""
    sync: SyncConfig = SyncConfig()
    stereo: StereoConfig = StereoConfig()
    surface: SurfaceConfig = SurfaceConfig()
    odometry: OdometryConfig = OdometryConfig()
    lanes: LanesConfig = LanesConfig()
    objects: ObjectsConfig = ObjectsConfig()
    occupancy: OccupancyConfig = OccupancyConfig()

    def to_toml(self) -> str:
        """The whole configuration, defaults included; ``load_config`` reads it back."""
        return tomli_w.dumps(self.model_dump(mode="json"))
