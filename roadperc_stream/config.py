"""One frozen model per stage, nested in ``ReplayConfig``; TOML in, TOML out.

Every key has a default, so no file is needed. Lengths in pixels are given at 960 image rows and scale with the image.
"""

import difflib
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from roadperc_stream.errors import ConfigError
from roadperc_stream.semantics import CLASS_NAMES, table_for_version


def _known_classes(names: tuple[str, ...]) -> tuple[str, ...]:
    unknown = [name for name in names if name not in CLASS_NAMES]
    if unknown:
        raise ValueError(f"unknown class {unknown[0]!r}; known: {', '.join(sorted(CLASS_NAMES))}")
    return names


def _known_table(version: str) -> str:
    try:
        return version if version == "auto" else table_for_version(version).name
    except ConfigError as error:
        raise ValueError(str(error)) from error


def _split(names: Any) -> Any:
    """One class, or several by commas, as a command line gives them."""
    return tuple(name.strip() for name in names.split(",")) if isinstance(names, str) else names


Classes = Annotated[tuple[str, ...], BeforeValidator(_split), AfterValidator(_known_classes)]
Ratio = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(ge=1e-6, le=1e4, allow_inf_nan=False)]
Pixels = Annotated[float, Field(ge=0.1, le=1e3, allow_inf_nan=False)]
Seconds = Annotated[float, Field(ge=0.0, le=3600.0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, le=100_000)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class SyncConfig(_Model):
    """How messages of several sensors become one frame."""

    tolerance_s: Seconds = 0.01
    """Largest difference of stamps within one frame."""
    max_wait_s: Seconds = 1.0
    """How far the log is read past a frame for a sensor whose messages arrive late."""


class SurfaceConfig(_Model):
    """The drivable surface, by RANSAC on road points."""

    enabled: bool = True
    model: Literal["plane"] = "plane"
    classes: Classes = ("road", "road_line", "ground")
    """Classes one may drive on; a sidewalk stands higher than the road and is none."""
    inlier_m: Positive = 0.05
    """Largest distance to the plane of an inlier."""
    drivable_m: Positive = 0.15
    """Largest distance to the plane of a drivable pixel."""
    hypotheses: Count = 256
    """Most planes tried."""
    batch: Count = 32
    """Planes tried at once."""
    subsample: Count = 2048
    """Points they are tried on."""
    enough_inliers: Ratio = 0.95
    """Share of inliers at which no further planes are tried."""
    min_inliers: Ratio = 0.2
    """Share of inliers below which there is no plane."""
    max_depth_m: Positive = 60.0
    max_tilt_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 30.0
    """Largest angle between the plane and the road the mounting promises."""
    assumed_height_m: Positive = 1.5
    """Height of the camera where neither a mounting nor depth tells."""


class LanesConfig(_Model):
    """The ego lane, by edges and Hough lines of the segmentation, smoothed over time."""

    enabled: bool = True
    model: Literal["line", "curve"] = "curve"
    """``line`` is the course's method; ``curve`` fits the boundary on the road, so that bends are followed."""
    separators: Classes = ("road_line", "sidewalk", "rail_track", "guard_rail")
    median_px: Annotated[int, Field(ge=0, le=99)] = 5
    """Size of the median filter on the separators' mask; 0 is none."""
    canny_low: Positive = 100.0
    canny_high: Positive = 150.0
    canny_aperture: Literal[3, 5, 7] = 3
    hough_rho_px: Pixels = 2.0
    hough_theta_deg: Annotated[float, Field(ge=0.05, le=90.0)] = 1.0
    hough_threshold: Positive = 100.0
    hough_min_length_px: Pixels = 100.0
    hough_max_gap_px: Pixels = 50.0
    min_slope: Positive = 0.3
    merge_slope: Positive = 0.1
    merge_intercept_px: Pixels = 40.0
    near_m: Positive = 15.0
    """A line whose nearest support lies farther ahead (ego x) is no boundary of the ego lane."""
    fit_max_m: Annotated[float, Field(ge=1.0, le=500.0)] = 40.0
    """Farthest point of the boundary that the curve is fitted to."""
    fit_strip_m: Positive = 0.3
    """Half width of the strip around the last fit whose edges the next one takes."""
    fit_huber: Annotated[float, Field(ge=0.1, le=100.0)] = 2.0
    """Standard deviations beyond which an edge counts less and less (Huber's constant)."""
    gate: Positive = 16.27
    """Squared Mahalanobis distance beyond which a measurement is not taken (99.9 % of chi squared, 3 degrees)."""
    hold_s: Seconds = 0.5
    """How long an unseen boundary is held before it is lost."""
    process_noise: Annotated[float, Field(ge=1e-3, le=100.0)] = 0.5
    """Standard deviation in m/s^2 of the car's sideways acceleration."""
    offset_std_m: Positive = 0.05
    heading_std: Positive = 0.01
    curvature_std_per_m: Positive = 0.002


class ObjectsConfig(_Model):
    """Detections filtered by segmentation, with their distance."""

    enabled: bool = True
    min_class_ratio: Ratio = 0.3
    """A detection is kept when more than this share of its box carries its class."""
    distance_quantile: Ratio = 0.02
    """0 is the lecture's minimum."""
    distance_pixels: Literal["class", "box"] = "class"
    """Pixels of the box that count for the distance: those of its class, or all (the lecture's variant)."""


STAGES = ("surface", "lanes", "objects")
"""Stages in the order in which they run; each has a section below."""
NEEDS = {"lanes": ("surface",)}
"""Stages that cannot work without others."""


class ReplayConfig(_Model):
    """Everything that decides what a replay computes."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    tag_table: Annotated[str, AfterValidator(_known_table)] = "auto"
    """Tag table of logs that do not name theirs: a CARLA version, a table's name, or ``auto`` (what the log says)."""
    sync: SyncConfig = SyncConfig()
    surface: SurfaceConfig = SurfaceConfig()
    lanes: LanesConfig = LanesConfig()
    objects: ObjectsConfig = ObjectsConfig()

    def to_toml(self) -> str:
        """The whole configuration, defaults included; ``load_config`` reads it back."""
        return tomli_w.dumps(self.model_dump(mode="json"))


def load_config(path: Path | None = None, settings: tuple[str, ...] = ()) -> ReplayConfig:
    """Configuration of a TOML file and ``KEY=VALUE`` settings, the settings winning.

    Args:
        path: TOML file with any part of the keys; None for the defaults.
        settings: such as ``lanes.hold_s=0.8``; the value is TOML, a bare word is a string.

    Raises:
        ConfigError: the file cannot be read, or a key or value does not fit; the message names it.

    """
    tree = _read_toml(path) if path else {}
    for setting in settings:
        key, separator, value = setting.partition("=")
        if not separator:
            raise ConfigError(f"--set {setting}: expected KEY=VALUE, such as lanes.hold_s=0.8")
        _assign(tree, key.strip().split("."), _toml_value(value.strip()), setting)
    try:
        return ReplayConfig.model_validate(tree)
    except RecursionError as error:
        raise ConfigError(f"{path or 'setting'}: nested too deeply") from error
    except ValidationError as error:
        raise ConfigError(f"{path or 'setting'}: {_complaint(error)}") from error


def _complaint(error: ValidationError) -> str:
    first = error.errors()[0]
    *sections, name = (str(part) for part in first["loc"])
    key = ".".join((*sections, name))
    if first["type"] != "extra_forbidden":
        return f"{key}: {first['msg']}, got {first['input']!r}"
    model: type[BaseModel] = ReplayConfig
    for section in sections:
        model = type(model.model_fields[section].default)
    close = difflib.get_close_matches(name, model.model_fields, n=1)
    known = f"did you mean {close[0]}?" if close else f"known: {', '.join(model.model_fields)}"
    return f"no setting {key}; {known}"


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from error


def _toml_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _assign(tree: dict[str, Any], keys: list[str], value: Any, setting: str) -> None:
    for key in keys[:-1]:
        tree = tree.setdefault(key, {})
        if not isinstance(tree, dict):
            raise ConfigError(f"--set {setting}: {key} is a value, not a table")
    tree[keys[-1]] = value
