"""One frozen model per stage, nested in ``ReplayConfig``; TOML in, TOML out. Every key has a default."""

from roadperc_stream.config.fields import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.config.loading import load_config, validated
from roadperc_stream.config.stages import (
    BUILT_IN,
    LanesConfig,
    ObjectsConfig,
    OccupancyConfig,
    OdometryConfig,
    ReplayConfig,
    StereoConfig,
    SurfaceConfig,
    SyncConfig,
    implementations,
    scaled,
)
from roadperc_stream.schemas.topics import NEEDS, STAGES, switched_off
