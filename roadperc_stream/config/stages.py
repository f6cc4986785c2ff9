"""The whole configuration of a replay: the settings of each stage, with their defaults and meaning.

Lengths in pixels are given at 960 image rows and scale with the image.
"""

from base64 import b64decode
from typing import Annotated, Final, Literal, Self

import tomli_w
from pydantic import Field, model_validator

from roadperc_stream.config.fields import (
    Classes,
    Count,
    OddCount,
    Pixels,
    Positive,
    Ratio,
    Seconds,
    Section,
    TableName,
    unit,
)
from roadperc_stream.config.limits import LimitsConfig

MOST_PNG_BYTES = 1_000_000
"""Of a picture in base 64 that a configuration holds."""
_MOST_PNG_PIXELS = 4_000_000
_PNG_HEADER = 32
"""Characters in base 64 of a PNG's first 24 bytes, which end in width and height."""
_PNG_IN_BASE64 = "^(iVBORw0KGgo[A-Za-z0-9+/]*={0,2})?$"
"""What the eight bytes that begin a PNG are in base 64, and its characters."""
_CONFIG_ROWS: Final = 960.0


def scaled(length_px: float, rows: int) -> float:
    """A length of the configuration, given at 960 image rows, in an image of so many rows."""
    return length_px * rows / _CONFIG_ROWS


class SyncConfig(Section):
    """How messages of several sensors become one frame."""

    tolerance_s: Seconds = 0.01
    """Largest difference of stamps within one frame."""
    max_wait_s: Seconds = 1.0
    """How far behind the reference sensor's latest stamp a message may come and still find its place."""


class StereoConfig(Section):
    """Depth from a stereo pair by semi-global matching.

    What is matched is the image itself with ``full`` and one of half its rows and columns with ``fast``; ``block_px``,
    ``left_right_px``, ``speckle_px``, ``speckle_step_px`` and ``refine_px`` count its pixels and do not scale with the
    image.
    """

    method: Literal["fast", "full", "off"] = "fast"
    """``fast`` matches at half resolution, ``full`` at full resolution; both along three directions."""
    disparities: Annotated[Annotated[int, Field(ge=16, multiple_of=16, le=1024)] | Literal["auto"], unit("px")] = "auto"
    """Disparities tried, from 0; ``auto``: what the nearest road pixel needs."""
    block_px: OddCount = 5
    """Side of the square that is compared."""
    p1: Annotated[Count, unit("matching cost")] = 200
    """Penalty for neighbours one disparity apart: about 8 per pixel of the block, for grey levels."""
    p2: Annotated[Count, unit("matching cost")] = 800
    """Penalty for neighbours farther apart, above ``p1``: about 32 per pixel of the block."""
    uniqueness_percent: Annotated[int, Field(ge=0, lt=100)] = 10
    """Margin by which the best disparity's cost must win against those not beside it; 0 is none."""
    left_right_px: Count = 1
    """Largest difference between a pixel's disparity and its partner's, seen from the right."""
    speckle_px: Annotated[int, Field(ge=0, le=1e4)] = 100
    """Patches of fewer pixels than this that stand alone are unknown; 0 keeps all."""
    speckle_step_px: Count = 2
    """Disparities within one patch differ by no more than this from pixel to pixel."""
    refine_px: OddCount | Literal[0] = 7
    """Side of the square by whose slopes the disparities are refined; 0 leaves them as matched, in sixteenths."""
    min_disparity_px: Positive = 1.0
    """Pixels of the image: a smaller disparity is unknown, for its depth would be mostly error."""

    @model_validator(mode="after")
    def _penalties_in_order(self) -> Self:
        if self.p2 <= self.p1:
            raise ValueError(f"p2 must exceed p1: p1 {self.p1}, p2 {self.p2}")
        return self

    @property
    def enabled(self) -> bool:
        """Whether the stage runs."""
        return self.method != "off"


class SurfaceConfig(Section):
    """The drivable surface, by RANSAC on road points."""

    enabled: bool = True
    """Whether the surface is estimated; lanes, occupancy and the scale of odometry without depth need it."""
    model: Literal["auto", "plane", "spline"] = "auto"
    """``spline`` adds a smooth height field to the plane, for roads that climb and fall; ``auto`` does so in frames
    whose road leaves its plane by more than the field's own error. Both need depth."""
    classes: Classes = ("road", "road_line", "ground")
    """Classes one may drive on; a sidewalk stands higher than the road and is none."""
    inlier_m: Positive = 0.05
    """Largest distance to the plane of an inlier."""
    hypotheses: Annotated[Count, unit("planes")] = 256
    """Most planes tried."""
    max_depth_m: Positive = 60.0
    """Farthest point, along the camera's axis, that the plane is fitted to."""
    max_tilt_deg: Annotated[float, Field(gt=0.0, lt=90.0)] = 30.0
    """Largest angle between the plane and the road that the mounting implies; a wall is not a road."""
    assumed_height_m: Positive = 1.5
    """Height of the camera above the road where neither a mounting nor depth gives it."""
    hold_m: Annotated[float, Field(ge=0.0, le=1000.0)] = 30.0
    """How far the car may drive on the plane of the frames before, by odometry, where a frame's depth does not
    show the road; farther on the mounting's stands in."""
    spline_knot_m: Annotated[float, Field(ge=1.0, le=30.0)] = 5.0
    """Distance of the height field's knots along the road."""
    spline_curvature_per_m: Positive = 0.005
    """Standard deviation of the road's curvature upwards; smaller is smoother. A crest of 200 m radius has 0.005."""
    spline_half_width_m: Annotated[float, Field(ge=2.0, le=50.0)] = 10.0
    """How far to either side of the ego x axis points count for the height field."""


class LanesConfig(Section):
    """The ego lane, by edges and Hough lines of the segmentation, smoothed over time."""

    enabled: bool = True
    """Whether lanes are detected."""
    model: Literal["line", "curve"] = "curve"
    """``line`` is the straight Hough line alone; ``curve`` fits the boundary on the road and follows bends."""
    separators: Classes = ("road_line", "sidewalk", "rail_track", "guard_rail")
    """Classes between which and the road the edges of a lane lie."""
    median_px: Annotated[int, Field(ge=0, le=99)] = 5
    """Size of the median filter on the separators' mask; 0 is none."""
    canny_low: Annotated[Positive, unit("grey levels")] = 100.0
    """Gradient from which a pixel next to an edge belongs to it: the lower threshold of Canny's detector."""
    canny_high: Annotated[Positive, unit("grey levels")] = 150.0
    """Gradient from which a pixel is an edge: the upper threshold of Canny's detector."""
    canny_aperture: Annotated[Literal[3, 5, 7], unit("px")] = 3
    """Side of the Sobel filter that measures the gradient."""
    hough_rho_px: Pixels = 2.0
    """Resolution of the distance in the Hough transform; coarser gathers more edge pixels in a line."""
    hough_threshold: Annotated[Positive, unit("px")] = 100.0
    """Edge pixels that must agree on a line."""
    hough_min_length_px: Pixels = 100.0
    """Shortest line."""
    hough_max_gap_px: Pixels = 50.0
    """Largest gap within a line."""
    fit_strip_m: Positive = 0.3
    """Half width of the strip around the last fit whose edges the next one takes."""
    gate: Annotated[Positive, unit("standard deviations, squared")] = 48.8
    """Squared Mahalanobis distance beyond which a measurement is rejected: three times 99.9 % of chi squared, 3
    degrees, for wrong tags err by more than noise does. What lies within, but far, widens the standard deviation."""
    car_width_m: Positive = 1.8
    """Width of the car: while a boundary is under it, the car is changing lanes."""
    hold_s: Seconds = 0.5
    """How long an unseen boundary is held before it is lost; also the window of the vote on the classes beside it."""
    use_odometry: bool = True
    """Whether odometry, where it is metric, predicts the boundaries from frame to frame."""
    process_noise: Annotated[float, Field(ge=1e-3, le=100.0), unit("m/s")] = 0.5
    """Standard deviation by which the car's sideways speed changes within a second, where no odometry predicts it."""


class ObjectsConfig(Section):
    """Detections filtered by segmentation, with their distance, and tracked over time."""

    enabled: bool = True
    """Whether detections are filtered and tracked."""
    filter: Literal["region", "class_ratio"] = "region"
    """What keeps a detection: pixels of its class, connected in depth or of one instance, that fit its box; or the
    share of its box that carries its class. Without dense depth and without instance masks it is the share."""
    min_class_ratio: Ratio = 0.3
    """With ``filter`` ``class_ratio`` a detection is kept when more than this share of its box carries its class."""
    distance_quantile: Ratio = 0.05
    """Quantile of the distances of the object's pixels that is its distance; 0 is the nearest pixel."""
    distance_pixels: Literal["region", "class", "box"] = "region"
    """Pixels that count for the distance: those that fit its box, those of its class in it, or all in it."""
    hold_s: Annotated[float, Field(ge=0.0, le=1e4)] = 0.5
    """How long an object without a detection is carried, and searched for in the image."""
    template_search: bool = True
    """Whether an object without a detection is searched for by its last image patch; this needs the decoded image."""
    carry_after_s: Annotated[float, Field(ge=0.0, le=1e4)] = 0.1
    """How long an object must have been seen without a gap to be searched for: stray detections are not carried on."""
    template_min_score: Ratio = 0.7
    """Normalised cross-correlation from which the patch counts as found."""
    template_png: Annotated[
        str, Field(max_length=MOST_PNG_BYTES, pattern=_PNG_IN_BASE64, json_schema_extra={"remark": "a PNG in base 64"})
    ] = ""
    """An obstacle's picture, which is searched for in every frame; ``--template`` fills it in."""
    template_distance: Literal["ray", "depth"] = "ray"
    """How far that obstacle is: straight from the camera, or its depth along the camera's axis."""
    min_overlap: Ratio = 0.2
    """Intersection over union with an object's predicted box from which a detection may be the same object."""
    gate: Annotated[Positive, unit("standard deviations, squared")] = 10.83
    """Squared Mahalanobis distance beyond which a distance is rejected (99.9 % of chi squared, 1 degree)."""
    restart_s: Positive = 0.2
    """How long distances beyond the gate must follow each other until they are believed."""
    min_distance_std_m: Positive = 0.1
    """Least standard deviation of a measured distance: the quantile moves with the box."""
    process_noise: Annotated[Positive, unit("m/s")] = 1.5
    """Standard deviation by which an object's closing speed changes within a second."""
    max_speed_std_mps: Positive = 2.0
    """Largest standard deviation at which a closing speed is given."""
    min_closing_mps: Positive = 0.5
    """Least closing speed at which a time to impact is given."""
    min_closing_sigmas: Annotated[float, Field(ge=0.0, le=1e4), unit("standard deviations")] = 2.0
    """Least closing speed, in its own standard deviations, at which a time to impact is given."""
    car_width_m: Positive = 1.8
    """Width of the car: its path is as wide, and ``path_margin_m`` wider on either side."""
    path_margin_m: Annotated[float, Field(ge=0.0, le=10.0)] = 0.3
    """What is beside the car by no more than this is in its path."""
    cut_in_mps: Positive = 0.3
    """Least speed, towards the path, of an object over the lane's line that cuts in."""

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


class OdometryConfig(Section):
    """Where the car is, from images and depth."""

    enabled: bool = True
    """Whether the motion of the car is estimated."""
    features: Literal["klt", "orb", "sift"] = "klt"
    """``klt`` follows corners by optical flow, ``orb`` and ``sift`` match descriptors."""
    matcher: Literal["brute_force", "flann"] = "brute_force"
    """How the nearest descriptors are found."""
    min_rows: Annotated[Count, unit("rows")] = 480
    """The image is halved as long as it keeps this many rows: more take longer and hardly improve the result."""
    min_inliers: Annotated[Count, unit("points")] = 20
    """Points that must agree on the motion, or the frame is lost."""
    max_speed_mps: Positive = 70.0
    """A faster motion is a jump the car cannot make, and the frame is lost."""
    max_turn_rate_dps: Positive = 120.0
    """A faster turn is one the car cannot make, and the frame is lost."""
    pitch_std_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 2.0
    """Without depth: standard deviation of the mounting's pitch, which the drive corrects; 0 believes the mounting."""


class OccupancyConfig(Section):
    """A bird's-eye grid of what is free and what is occupied, in the ego frame."""

    enabled: bool = True
    """Whether the grid is made."""
    resolution_m: Annotated[float, Field(ge=0.05, le=5.0)] = 0.2
    """Side of a cell."""
    x_min_m: Annotated[float, Field(ge=-65.0, lt=65.0)] = 0.0
    """Nearest edge of the grid, ahead of the ego origin."""
    x_max_m: Annotated[float, Field(gt=-65.0, le=65.0)] = 40.0
    """Farthest edge. Depth as the log stores it ends at 65.535 m, where everything beyond would seem to be."""
    half_width_m: Annotated[float, Field(gt=0.0, le=65.0)] = 15.0
    """The grid reaches so far to either side."""
    min_height_m: Positive = 0.3
    """Points of any class are obstacles from this height above the road on; a kerb is lower."""
    max_height_m: Positive = 2.5
    """Points higher above the road than this are no obstacles."""
    obstacle_classes: Classes = ("vehicle", "pedestrian")
    """Classes whose points are obstacles however low they are."""
    pixel_step: Annotated[Count, unit("px")] = 2
    """Every so many rows and columns of the image give a point."""
    min_points: Annotated[Count, unit("points")] = 3
    """Points that make a cell occupied or free."""
    depth_tolerance: Ratio = 0.1
    """A cell between the points is free where its pixel is drivable and as far away as the cell, up to this share."""

    @model_validator(mode="after")
    def _extents(self) -> Self:
        if self.x_max_m < self.x_min_m + self.resolution_m:
            raise ValueError(f"x_max_m {self.x_max_m} leaves no cell beyond x_min_m {self.x_min_m}")
        if self.max_height_m <= self.min_height_m:
            raise ValueError(f"max_height_m {self.max_height_m} is not above min_height_m {self.min_height_m}")
        return self


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
