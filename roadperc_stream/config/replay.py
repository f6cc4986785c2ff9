"""The whole configuration of a replay."""

from typing import Annotated

import tomli_w
from pydantic import Field

from roadperc_stream.config.fields import Section, TableName
from roadperc_stream.config.limits import LimitsConfig
from roadperc_stream.config.stages import (
    LanesConfig,
    ObjectsConfig,
    OccupancyConfig,
    OdometryConfig,
    StereoConfig,
    SurfaceConfig,
    SyncConfig,
)


class ReplayConfig(Section):
    """Everything that decides what a replay computes."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Random numbers follow from it and from the frame's stamp: the same seed gives the same results."""
    tag_table: TableName = "auto"
    """Table of the segmentation's tag numbers: a CARLA version or a table's name; ``auto`` takes what the log says."""
    sync: SyncConfig = SyncConfig()
    stereo: StereoConfig = StereoConfig()
    surface: SurfaceConfig = SurfaceConfig()
    odometry: OdometryConfig = OdometryConfig()
    lanes: LanesConfig = LanesConfig()
    objects: ObjectsConfig = ObjectsConfig()
    occupancy: OccupancyConfig = OccupancyConfig()
    limits: LimitsConfig = LimitsConfig()

    def to_toml(self) -> str:
        """The whole configuration, defaults included; ``load_config`` reads it back."""
        return tomli_w.dumps(self.model_dump(mode="json"))
