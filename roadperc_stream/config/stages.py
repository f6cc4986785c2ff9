"""The whole configuration of a replay: the settings of each stage, with their defaults and meaning.

Lengths in pixels are given at 960 image rows and scale with the image.
"""

from base64 import b64decode
from collections.abc import Iterator
from typing import Annotated, Final, Literal, Self

import tomli_w
from pydantic import Field, model_validator

from roadperc_stream.config import fields
from roadperc_stream.config.calibration import CalibrationConfig
from roadperc_stream.config.fields import Classes, Count, Pixels, Positive, Ratio, Seconds, Section, unit

MOST_PNG_BYTES = 1_000_000
"""Largest length of a picture in base 64 in a configuration."""
_MOST_PNG_PIXELS = 4_000_000
_PNG_HEADER = 32
"""Number of base 64 characters for a PNG's first 24 bytes, which end in width and height."""
_PNG_IN_BASE64 = "^(iVBORw0KGgo[A-Za-z0-9+/]*={0,2})?$"
"""Pattern of a PNG in base 64, by its first eight bytes."""
_CONFIG_ROWS: Final = 960.0
OWN_STAGES: Final = ("stereo", "surface", "odometry", "lanes", "objects")
"""Stages that the user can replace."""
BUILT_IN: Final = fields.BUILT_IN
ABOUT_THE_LOG: Final[tuple[str, ...]] = ("calibration", "labels")
"""Tables that do not set a stage, but say what the log does not, or says wrongly."""


def scaled(length_px: float, rows: int) -> float:
    """A length of the configuration, given at 960 image rows, scaled to ``rows`` image rows."""
    return length_px * rows / _CONFIG_ROWS


class StageSection(Section):
    """The settings of a stage that the user can replace."""

    implementation: fields.ImplementationName = BUILT_IN
    """The code of the stage: ``built-in``, or your own, such as ``my_package.module:MyLanes``."""
    implementation_source: Annotated[str, Field(max_length=1000, json_schema_extra={"remark": "a text"})] = ""
    """Version and digest of the source of your own stage. A replay sets it; a value must match the source."""
    written_if_set = ("implementation", "implementation_source")


class SyncConfig(Section):
    """How messages of several sensors become one frame."""

    tolerance_s: Seconds = 0.01
    """Largest difference of stamps within one frame."""
    max_wait_s: Seconds = 1.0
    """How late a message may arrive, behind the latest stamp of the reference sensor."""


class StereoConfig(StageSection):
    """Depth from a stereo pair by semi-global matching.

    ``full`` matches the image itself, ``fast`` an image with half its rows and columns. ``block_px``,
    ``speckle_px`` and ``refine_px`` are pixels of the matched image.
    """

    method: Literal["fast", "full", "off"] = "fast"
    """``fast`` matches at half resolution, ``full`` at full resolution; both along three directions."""
    disparities: Annotated[Annotated[int, Field(ge=16, multiple_of=16, le=1024)] | Literal["auto"], unit("px")] = "auto"
    """Number of disparities to search, from 0; ``auto``: up to the nearest road pixel."""
    block_px: fields.OddCount = 5
    """Side of the block that is matched."""
    p1: Annotated[Count, unit("matching cost")] = 200
    """Penalty for neighbours that differ by one disparity: about 8 per pixel of the block."""
    p2: Annotated[Count, unit("matching cost")] = 800
    """Penalty for neighbours that differ by more: about 32 per pixel of the block."""
    uniqueness_percent: Annotated[int, Field(ge=0, lt=100)] = 10
    """Margin by which the best cost must beat those of other disparities."""
    speckle_px: Annotated[int, Field(ge=0, le=1e4)] = 100
    """Isolated patches with fewer pixels become unknown."""
    refine_px: fields.OddCount | Literal[0] = 7
    """Side of the window whose gradients refine the disparities; 0: no refinement."""
    min_disparity_px: Positive = 1.0
    """Smaller disparities, in pixels of the image, are unknown."""

    @model_validator(mode="after")
    def _penalties_in_order(self) -> Self:
        if self.p2 <= self.p1:
            raise ValueError(f"p2 must exceed p1: p1 {self.p1}, p2 {self.p2}")
        return self

    @property
    def enabled(self) -> bool:
        """Whether the stage runs."""
        return self.method != "off"


class SurfaceConfig(StageSection):
    """The drivable surface, by RANSAC on road points."""

    enabled: bool = True
    """Whether to estimate the surface, which lanes and occupancy need."""
    model: Literal["auto", "plane", "spline"] = "auto"
    """``spline`` adds a height field to the plane, ``auto`` only where the road is not flat."""
    classes: Classes = ("road", "road_line", "ground")
    """Drivable classes."""
    inlier_m: Positive = 0.05
    """Largest distance of an inlier from the plane."""
    hypotheses: Annotated[Count, unit("planes")] = 256
    """Most planes that RANSAC tries."""
    max_depth_m: Positive = 60.0
    """Largest depth of the fitted points."""
    max_tilt_deg: Annotated[float, Field(gt=0.0, lt=90.0)] = 30.0
    """Largest angle between the plane and the level road of the mounting."""
    assumed_height_m: Positive = 1.5
    """Height of the camera above the road if neither a mounting nor depth gives it."""
    hold_m: Annotated[float, Field(ge=0.0, le=1000.0)] = 30.0
    """Distance over which the plane of earlier frames is held without depth."""
    spline_knot_m: Annotated[float, Field(ge=1.0, le=30.0)] = 5.0
    """Distance between the knots of the height field along the road."""
    spline_curvature_per_m: Positive = 0.005
    """Standard deviation of the road's vertical curvature; smaller is smoother."""
    spline_half_width_m: Annotated[float, Field(ge=2.0, le=50.0)] = 10.0
    """The height field uses points up to this distance to either side."""


class LanesConfig(StageSection):
    """The ego lane, by edges and Hough lines of the segmentation, smoothed over time."""

    enabled: bool = True
    """Whether to detect lanes."""
    model: Literal["line", "curve"] = "curve"
    """``line`` uses only the straight Hough line; ``curve`` fits the boundary on the road."""
    separators: Classes = ("road_line", "sidewalk", "rail_track", "guard_rail")
    """Classes whose borders with the road are the edges of a lane."""
    median_px: Annotated[int, Field(ge=0, le=99)] = 5
    """Size of the median filter on the separators; 0: no filter. If it has 5 or more pixels in the image, edges are
    searched in every second row and column."""
    canny_low: Annotated[Positive, unit("grey levels")] = 100.0
    """Lower threshold of Canny's detector: continues an edge."""
    canny_high: Annotated[Positive, unit("grey levels")] = 150.0
    """Upper threshold of Canny's detector: starts an edge."""
    canny_aperture: Annotated[Literal[3, 5, 7], unit("px")] = 3
    """Size of the Sobel filter that measures the gradient."""
    hough_rho_px: Pixels = 2.0
    """Distance resolution of the Hough transform."""
    hough_threshold: Annotated[Positive, unit("px")] = 100.0
    """Least number of edge pixels on a line."""
    hough_min_length_px: Pixels = 100.0
    """Length of the shortest line."""
    hough_max_gap_px: Pixels = 50.0
    """Length of the largest gap within a line."""
    fit_strip_m: Positive = 0.3
    """Half width of the strip around the last fit for the next one."""
    gate: Annotated[Positive, unit("standard deviations, squared")] = 48.8
    """Squared Mahalanobis distance beyond which a measurement is rejected: three times the 99.9 % quantile of chi
    squared, 3 degrees of freedom."""
    car_width_m: Positive = 1.8
    """Width of the car, for lane changes."""
    hold_s: Seconds = 0.5
    """How long an unseen boundary is held before it is lost."""
    use_odometry: bool = True
    """Whether metric odometry predicts the boundaries."""
    process_noise: Annotated[float, Field(ge=1e-3, le=100.0), unit("m/s")] = 0.5
    """Standard deviation of the change of lateral speed within a second, without odometry."""


class ObjectsConfig(StageSection):
    """Detections filtered by segmentation, with their distance, and tracked over time."""

    enabled: bool = True
    """Whether to filter and track detections."""
    filter: Literal["region", "class_ratio"] = "region"
    """``region`` compares the box with connected pixels of its class, ``class_ratio`` with their share."""
    min_class_ratio: Ratio = 0.3
    """Least share of the box with its class, for ``class_ratio``."""
    distance_quantile: Ratio = 0.05
    """Quantile of the pixels' distances that is the object's distance; 0: the nearest pixel."""
    distance_pixels: Literal["region", "class", "box"] = "region"
    """Pixels that determine the distance: the region of the object, its class, or the whole box."""
    hold_s: Annotated[float, Field(ge=0.0, le=1e4)] = 0.5
    """How long an object without a detection is searched for."""
    template_search: bool = True
    """Whether to search for an object without a detection by its last image patch."""
    carry_after_s: Annotated[float, Field(ge=0.0, le=1e4)] = 0.1
    """How long an object must be detected without a gap before it is held."""
    template_min_score: Ratio = 0.7
    """Least normalised cross-correlation with which a patch is found."""
    template_png: Annotated[
        str, Field(max_length=MOST_PNG_BYTES, pattern=_PNG_IN_BASE64, json_schema_extra={"remark": "a PNG in base 64"})
    ] = ""
    """Picture of an obstacle to search for in every frame; ``--template`` sets it."""
    template_distance: Literal["ray", "depth"] = "ray"
    """Distance of that obstacle: along the ray, or along the camera's axis."""
    min_overlap: Ratio = 0.2
    """Least overlap of a detection with the predicted box of its object."""
    gate: Annotated[Positive, unit("standard deviations, squared")] = 10.83
    """Squared Mahalanobis distance beyond which a distance is rejected: 99.9 % of chi squared, 1 degree of freedom."""
    restart_s: Positive = 0.2
    """How long distances beyond the gate must continue before the track restarts."""
    min_distance_std_m: Positive = 0.1
    """Least standard deviation of a measured distance."""
    process_noise: Annotated[Positive, unit("m/s")] = 1.5
    """Standard deviation of the change of an object's closing speed within a second."""
    max_speed_std_mps: Positive = 2.0
    """A closing speed with a larger standard deviation is not reported."""
    min_closing_mps: Positive = 0.5
    """Least closing speed for which a time to impact is reported."""
    min_closing_sigmas: Annotated[float, Field(ge=0.0, le=1e4), unit("standard deviations")] = 2.0
    """Least closing speed, in its standard deviations, for which a time to impact is reported."""
    car_width_m: Positive = 1.8
    """Width of the car, for its path."""
    path_margin_m: Annotated[float, Field(ge=0.0, le=10.0)] = 0.3
    """Width that the path adds on either side."""
    cut_in_mps: Positive = 0.3
    """Least speed towards the path of an object that cuts in."""

    @model_validator(mode="after")
    def _picture_within_bounds(self) -> Self:
        if len(self.template_png) < _PNG_HEADER:
            return self
        header = b64decode(self.template_png[:_PNG_HEADER], validate=True)
        width, height = (int.from_bytes(header[k : k + 4], "big") for k in (16, 20))
        if width * height > _MOST_PNG_PIXELS:
            raise ValueError(
                f"template_png: a picture of {width}x{height} pixels, expected at most {_MOST_PNG_PIXELS:,}"
            )
        return self


class OdometryConfig(StageSection):
    """Where the car is, from images and depth."""

    enabled: bool = True
    """Whether to estimate the motion of the car."""
    features: Literal["klt", "orb", "sift"] = "klt"
    """``klt`` follows corners by optical flow, ``orb`` and ``sift`` match descriptors."""
    matcher: Literal["brute_force", "flann"] = "brute_force"
    """Search for the nearest descriptors."""
    min_rows: Annotated[Count, unit("rows")] = 480
    """The image is halved as long as it keeps this many rows."""
    min_inliers: Annotated[Count, unit("points")] = 20
    """Least number of points that agree on the motion; else the frame is lost."""
    max_speed_mps: Positive = 70.0
    """A frame with a faster motion is lost."""
    max_turn_rate_dps: Positive = 120.0
    """A frame with a faster turn is lost."""
    pitch_std_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 2.0
    """Standard deviation of the mounting's pitch, without depth; 0 trusts the mounting."""


class OccupancyConfig(Section):
    """A bird's-eye grid of free and occupied cells, in the ego frame."""

    enabled: bool = True
    """Whether to compute the grid."""
    resolution_m: Annotated[float, Field(ge=0.05, le=5.0)] = 0.2
    """Side of a cell."""
    x_min_m: Annotated[float, Field(ge=-65.0, lt=65.0)] = 0.0
    """Nearest edge of the grid, ahead of the ego origin."""
    x_max_m: Annotated[float, Field(gt=-65.0, le=65.0)] = 40.0
    """Farthest edge of the grid."""
    half_width_m: Annotated[float, Field(gt=0.0, le=65.0)] = 15.0
    """Extent of the grid to either side."""
    min_height_m: Positive = 0.3
    """Points of any class above this height over the road are obstacles."""
    max_height_m: Positive = 2.5
    """Points above this height are not obstacles."""
    obstacle_classes: Classes = ("vehicle", "pedestrian")
    """Classes whose points are obstacles at any height."""
    pixel_step: Annotated[Count, unit("px")] = 2
    """Step between the used rows and columns of the image."""
    min_points: Annotated[Count, unit("points")] = 3
    """Least number of points in a known cell."""
    depth_tolerance: Ratio = 0.1
    """A cell without points is free if its pixel is drivable and its depth agrees to this share."""

    @model_validator(mode="after")
    def _extents(self) -> Self:
        if self.x_max_m < self.x_min_m + self.resolution_m:
            raise ValueError(f"x_max_m {self.x_max_m} leaves no cell beyond x_min_m {self.x_min_m}")
        if self.max_height_m <= self.min_height_m:
            raise ValueError(f"max_height_m {self.max_height_m} is not above min_height_m {self.min_height_m}")
        return self


class ReplayConfig(Section):
    """All settings that the results of a replay depend on."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of the random numbers, together with the frame's stamp."""
    tag_table: fields.TableName = "auto"
    """Table of the segmentation's tag numbers; ``auto`` uses the log's table."""
    sync: SyncConfig = SyncConfig()
    stereo: StereoConfig = StereoConfig()
    surface: SurfaceConfig = SurfaceConfig()
    odometry: OdometryConfig = OdometryConfig()
    lanes: LanesConfig = LanesConfig()
    objects: ObjectsConfig = ObjectsConfig()
    occupancy: OccupancyConfig = OccupancyConfig()
    limits: fields.LimitsConfig = fields.LimitsConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    """The cameras, instead of those of the log."""
    labels: fields.Labels = Field(default_factory=dict)
    """Known labels by the labels of the log's detections."""
    written_if_set = ABOUT_THE_LOG

    def with_log_facts(self, recorded: Self) -> Self:
        """The same settings; what they do not say about the log is taken from ``recorded``."""
        calibration = self.calibration.over(recorded.calibration)
        return self.model_copy(update={"calibration": calibration, "labels": {**recorded.labels, **self.labels}})

    def to_toml(self) -> str:
        """The whole configuration, defaults included; ``load_config`` reads it back."""
        return tomli_w.dumps(self.model_dump(mode="json"))


def implementations(cfg: ReplayConfig) -> Iterator[tuple[str, str]]:
    """Stage and ``MODULE:NAME`` of each own stage of a configuration."""
    named = ((stage, getattr(cfg, stage).implementation) for stage in OWN_STAGES)
    return ((stage, name) for stage, name in named if name != BUILT_IN)
