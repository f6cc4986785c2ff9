"""The settings of a configuration file by their dotted keys."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final
from warnings import warn

from roadperc_stream.config.stages import ABOUT_THE_LOG, OWN_STAGES, UNSET
from roadperc_stream.errors import ConfigError
from roadperc_stream.system.text import in_brief, number

MOST_BYTES: Final = 1_000_000
"""Largest size of a configuration; all settings with their comments take 30 kB."""
_MOST_DOTS: Final = 100
"""Largest number of dots in a line; keys of settings have one."""
FIXED: Final[Mapping[str, float]] = {
    "surface.drivable_m": 0.15,
    "surface.batch": 32,
    "surface.subsample": 2048,
    "surface.enough_inliers": 0.95,
    "surface.min_inliers": 0.2,
    "odometry.match_ratio": 0.8,
    "odometry.max_points": 400,
    "odometry.cell_px": 80.0,
    "odometry.window_px": 20.0,
    "odometry.forward_backward_px": 1.0,
    "odometry.max_depth_m": 60.0,
    "odometry.depth_std_per_m": 0.0005,
    "odometry.inlier_px": 2.0,
    "odometry.ransac_iterations": 200,
    "odometry.min_inlier_ratio": 0.25,
    "odometry.min_parallax_px": 1.5,
    "odometry.keyframe_share": 0.5,
    "odometry.keyframe_flow_px": 60.0,
    "lanes.hough_theta_deg": 1.0,
    "lanes.min_slope": 0.3,
    "lanes.merge_slope": 0.1,
    "lanes.merge_intercept_px": 40.0,
    "lanes.near_m": 15.0,
    "lanes.fit_max_m": 40.0,
    "lanes.fit_huber": 2.0,
    "lanes.min_width_m": 2.0,
    "lanes.max_width_m": 7.0,
    "lanes.max_std_m": 0.16,
    "lanes.offset_std_m": 0.05,
    "lanes.heading_std": 0.01,
    "lanes.curvature_std_per_m": 0.002,
    "objects.min_fit": 0.7,
    "objects.min_fit_seen": 0.2,
    "objects.distance_penalty": 0.3,
    "objects.path_memory_m": 5.0,
    "objects.lane_width_min_m": 2.0,
    "objects.lane_width_max_m": 5.0,
    "objects.object_length_m": 5.0,
    "objects.lateral_std_m": 0.1,
    "objects.lateral_noise": 1.0,
}
"""Settings of older versions that are constants now, with their values; logs and tables still contain them."""

NOT_SET: Final = "not set"
"""Text for a setting about the log that a configuration does not contain, because the log itself says it."""
BUILT_IN_STAGES: Final = {f"{stage}.{name}": value for stage in OWN_STAGES for name, value in UNSET}
"""Settings that a configuration contains only with other values."""


def settings_in(toml: bytes) -> dict[str, Any]:
    """The settings of a TOML text by keys such as ``lanes.hold_s``, including unknown ones.

    Settings of older versions are left out if they have the value that is fixed now.

    Raises:
        ConfigError: the text is not TOML.
    """
    try:
        found = _flat(parsed_toml(toml))
    except RecursionError as error:
        raise ConfigError("not TOML of settings: nested too deeply") from error
    return {key: value for key, value in found.items() if key not in FIXED or FIXED[key] != value}


def is_about_log(key: str) -> bool:
    """Whether a key such as ``calibration.fov_deg`` says something about the log."""
    return key.partition(".")[0] in ABOUT_THE_LOG


def without_fixed(tree: dict[str, Any], source: Path) -> dict[str, Any]:
    """The settings of a file without those that are fixed now; warn once if there are any.

    Args:
        tree: nested as in the file, such as ``{"lanes": {"hold_s": 0.8}}``; changed in place.
        source: the file, for the warning.
    """
    dropped = {}
    for key in FIXED:
        section, _, name = key.partition(".")
        values = tree.get(section)
        if isinstance(values, dict) and name in values:
            dropped[key] = values.pop(name)
    if dropped:
        others = [f"{key} is {FIXED[key]}" for key, value in dropped.items() if value != FIXED[key]]
        found = f"{source}: {number(len(dropped), 'setting')} of an older version cannot be changed any more"
        warn("; ".join((found, *others)), stacklevel=2)
    return tree


def parsed_toml(toml: bytes) -> dict[str, Any]:
    """A TOML text as nested mappings.

    Raises:
        ConfigError: the text is not TOML, too long, nested too deeply, or a number in it has too many digits.
    """
    if len(toml) > MOST_BYTES:
        raise ConfigError(f"not TOML of settings: more than {MOST_BYTES} bytes")
    if any(line.count(b".") > _MOST_DOTS for line in toml.splitlines()):
        raise ConfigError("not TOML of settings: nested too deeply")  # the parser takes quadratic time
    try:
        return tomllib.loads(toml.decode())
    except RecursionError as error:
        raise ConfigError("not TOML of settings: nested too deeply") from error
    except ValueError as error:
        raise ConfigError(f"not TOML: {error}") from error


def as_typed(value: Any) -> str:
    """A value as on the command line."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else in_brief(value)


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat
