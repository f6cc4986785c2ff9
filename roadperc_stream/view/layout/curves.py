"""Plots of numbers over time, and of states in words."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Final

from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.topics import METRICS_TOPIC, TIMES_TOPIC
from roadperc_stream.view.layout.panels import Config, Panel, titled

BLUE: Final = "#4e98e2"
ORANGE: Final = "#f5774d"
GREEN: Final = "#3fae49"
PURPLE: Final = "#b07aa1"
_STAGE_COLOURS: Final = {
    "total": "#8c8c8c",
    "decode": BLUE,
    "surface": ORANGE,
    "lanes": GREEN,
    "objects": "#f0c419",
    "stereo": PURPLE,
    "odometry": "#e15759",
    "occupancy": "#76b7b2",
    "encode": "#9c755f",
    "read": "#a0cbe8",
    "metrics": "#d4a6c8",
    "copy": "#8cd17d",
    "write": "#d7b5a6",
}
_THIN: Final = 1.0
_THICK: Final = 2.5
_LEGEND_WIDTH_PX: Final = 150


@dataclass(frozen=True)
class PlotSeries:
    """A metric in a plot."""

    metric: str
    label: str
    colour: str
    width: float = _THICK
    joined: bool = True
    """Drawn as a line, else as points."""
    topic: str = METRICS_TOPIC


@dataclass(frozen=True)
class Plot:
    """Curves of one panel."""

    name: str
    title: str
    unit: str
    curves: tuple[PlotSeries, ...]


def _offsets(side: str) -> Plot:
    """Thick what the filter says, as points what it was fed with, thin what is true: the same on either side."""
    return Plot(
        f"{side}_offset",
        f"{side.capitalize()} boundary, offset",
        "m",
        (
            PlotSeries(f"lane_{side}_raw_offset_m", "raw", ORANGE, joined=False),
            PlotSeries(f"lane_{side}_offset_m", "smoothed", BLUE),
            PlotSeries(f"lane_{side}_true_offset_m", "true", GREEN, _THIN),
        ),
    )


def _offset_error(side: str) -> Plot:
    curve = PlotSeries(f"lane_{side}_error_m", "smoothed", BLUE)
    return Plot(f"{side}_error", f"{side.capitalize()} boundary, error at 10 m", "m", (curve,))


LEFT_OFFSET, RIGHT_OFFSET = _offsets("left"), _offsets("right")
LEFT_ERROR, RIGHT_ERROR = _offset_error("left"), _offset_error("right")
LANE: Final = Plot(
    "lane",
    "Lane",
    "m, degrees",
    (PlotSeries("lane_width_m", "width, m", BLUE), PlotSeries("lane_heading_deg", "heading, °", ORANGE)),
)
NEAREST: Final = Plot(
    "objects",
    "Nearest object",
    "m, s",
    (
        PlotSeries("nearest_object_m", "object, m", BLUE),
        PlotSeries("stereo_nearest_m", "stereo, m", PURPLE, _THIN),
        PlotSeries("time_to_impact_s", "impact, s", ORANGE),
    ),
)
MOTION: Final = Plot(
    "odometry",
    "Odometry",
    "m, degrees",
    (PlotSeries("step_m", "step, m", BLUE), PlotSeries("turn_deg", "turn, °", ORANGE)),
)
COUNTS: Final = Plot(
    "inliers",
    "Odometry inliers and detections",
    "count",
    (
        PlotSeries("odometry_inliers", "inliers", BLUE),
        PlotSeries("detections", "detections", ORANGE, _THIN),
        PlotSeries("detections_kept", "kept", GREEN),
    ),
)
CAMERA: Final = Plot(
    "surface",
    "Camera over the road",
    "m, degrees",
    (
        PlotSeries("camera_height_m", "height, m", BLUE),
        PlotSeries("camera_pitch_deg", "pitch, °", ORANGE),
        PlotSeries("camera_roll_deg", "roll, °", GREEN),
    ),
)
SHARES: Final = Plot(
    "shares",
    "Shares",
    "",
    (
        PlotSeries("drivable_ratio", "drivable", BLUE),
        PlotSeries("surface_inlier_ratio", "road inliers", ORANGE),
        PlotSeries("stereo_valid_ratio", "stereo valid", GREEN),
    ),
)
SURFACE_ERRORS: Final = Plot(
    "surface_errors",
    "Surface errors",
    "degrees, m",
    (
        PlotSeries("surface_angle_error_deg", "angle, °", BLUE),
        PlotSeries("camera_height_error_m", "camera, m", ORANGE),
        PlotSeries("surface_height_error_m", "road, m", GREEN),
    ),
)
OBJECT_ERRORS: Final = Plot(
    "object_errors",
    "Object and stereo errors",
    "m, px",
    (PlotSeries("object_distance_error_m", "distance, m", BLUE), PlotSeries("stereo_epe_px", "disparity, px", ORANGE)),
)
MOTION_ERRORS: Final = Plot(
    "odometry_errors",
    "Odometry errors",
    "m, degrees",
    (PlotSeries("step_error_m", "step, m", BLUE), PlotSeries("turn_error_deg", "turn, °", ORANGE)),
)
SCORES: Final = Plot(
    "scores",
    "Scores of road and boxes",
    "",
    (
        PlotSeries("drivable_iou", "drivable IoU", BLUE),
        PlotSeries("filter_precision", "box precision", ORANGE),
        PlotSeries("filter_recall", "box recall", GREEN),
    ),
)
STATES: Final = {
    "odometry_status": "odometry",
    "surface_source": "surface",
    "surface_model": "surface model",
    "nearest_object_class": "nearest object",
}
BOUNDARY_STATES: Final = {
    "lane_left_status": "left boundary",
    "lane_right_status": "right boundary",
    "lane_left_boundary_class": "beyond the left",
    "lane_right_boundary_class": "beyond the right",
}


def stage_times() -> Plot:
    """Milliseconds of each stage."""
    stages = [column.removesuffix("_ms") for column in TIME_COLUMNS]
    curves = [PlotSeries(f"{stage}_ms", stage, _STAGE_COLOURS[stage], _THIN, topic=TIMES_TOPIC) for stage in stages]
    return Plot("times", "Time per stage, ms (live only)", "ms", tuple(curves))


def plot(described: Plot, columns: Collection[str]) -> Panel | None:
    """A plot of those of its curves that are among ``columns``."""
    return _plot(described, [curve for curve in described.curves if curve.metric in columns])


def _plot(described: Plot, curves: Iterable[PlotSeries]) -> Panel | None:
    paths = [_path(curve) for curve in curves]
    if not paths:
        return None
    config: Config = {
        "paths": paths,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "left",
        "showPlotValuesInLegend": False,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": _LEGEND_WIDTH_PX,
        "yAxisLabel": described.unit,
    }
    return Panel("Plot", described.name, {**config, **titled(described.title)})


def _path(curve: PlotSeries) -> Config:
    return {
        "value": f"{curve.topic}.{curve.metric}",
        "enabled": True,
        "label": curve.label,
        "color": curve.colour,
        "timestampMethod": "receiveTime",
        "showLine": curve.joined,
        "lineSize": curve.width,
    }


def states(name: str, title: str, labels: dict[str, str], columns: Collection[str]) -> Panel | None:
    """Bars of words over time, of those metrics that are among ``columns``."""
    paths = [
        {
            "value": f"{METRICS_TOPIC}.{metric}",
            "label": label,
            "enabled": True,
            "timestampMethod": "receiveTime",
        }
        for metric, label in labels.items()
        if metric in columns
    ]
    return Panel("StateTransitions", name, {"isSynced": True, "paths": paths, **titled(title)}) if paths else None
