"""Plots of metrics and states over time."""

from collections.abc import Collection, Mapping
from typing import Final

from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.topics import METRICS_TOPIC, TIMES_TOPIC
from roadperc_stream.view.layout.panels import Config, Node, panel

_BLUE: Final = "#4e98e2"
_ORANGE: Final = "#f5774d"
_GREEN: Final = "#3fae49"
_PURPLE: Final = "#b07aa1"
STAGE_COLOURS: Final = {
    "total": "#8c8c8c",
    "decode": _BLUE,
    "surface": _ORANGE,
    "lanes": _GREEN,
    "objects": "#f0c419",
    "stereo": _PURPLE,
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


_PLOTS: Final[Mapping[str, tuple[str, str, Mapping[str, str]]]] = {
    **{
        f"{side}_offset": (
            f"{side.capitalize()} boundary, offset",
            "m",
            {
                f"lane_{side}_raw_offset_m": "raw",
                f"lane_{side}_offset_m": "smoothed",
                f"lane_{side}_true_offset_m": "true",
            },
        )
        for side in ("left", "right")
    },
    **{
        f"{side}_error": (f"{side.capitalize()} boundary, error at 10 m", "m", {f"lane_{side}_error_m": "smoothed"})
        for side in ("left", "right")
    },
    "lane": ("Lane", "m, degrees", {"lane_width_m": "width, m", "lane_heading_deg": "heading, °"}),
    "objects": (
        "Nearest object",
        "m, s",
        {"nearest_object_m": "object, m", "stereo_nearest_m": "stereo, m", "time_to_impact_s": "impact, s"},
    ),
    "odometry": ("Odometry", "m, degrees", {"step_m": "step, m", "turn_deg": "turn, °"}),
    "inliers": (
        "Odometry inliers and detections",
        "count",
        {"odometry_inliers": "inliers", "detections": "detections", "detections_kept": "kept"},
    ),
    "surface": (
        "Camera over the road",
        "m, degrees",
        {"camera_height_m": "height, m", "camera_pitch_deg": "pitch, °", "camera_roll_deg": "roll, °"},
    ),
    "shares": (
        "Shares",
        "",
        {"drivable_ratio": "drivable", "surface_inlier_ratio": "road inliers", "stereo_valid_ratio": "stereo valid"},
    ),
    "surface_errors": (
        "Surface errors",
        "degrees, m",
        {
            "surface_angle_error_deg": "angle, °",
            "camera_height_error_m": "camera, m",
            "surface_height_error_m": "road, m",
        },
    ),
    "object_errors": (
        "Object and stereo errors",
        "m, px",
        {"object_distance_error_m": "distance, m", "stereo_epe_px": "disparity, px"},
    ),
    "odometry_errors": ("Odometry errors", "m, degrees", {"step_error_m": "step, m", "turn_error_deg": "turn, °"}),
    "scores": (
        "Scores of road and boxes",
        "",
        {"drivable_iou": "drivable IoU", "filter_precision": "box precision", "filter_recall": "box recall"},
    ),
}
"""Title, unit, and labels by metric of each plot, by the name of its panel.

The curves are thick lines in blue, orange and green unless ``_STYLES`` differs.
"""
_STYLES: Final[Mapping[str, Config]] = {
    "raw": {"color": _ORANGE, "showLine": False},
    "smoothed": {"color": _BLUE},
    "true": {"color": _GREEN, "lineSize": _THIN},
    "stereo, m": {"color": _PURPLE, "lineSize": _THIN},
    "impact, s": {"color": _ORANGE},
    "detections": {"lineSize": _THIN},
}
"""Styles by label: points for a filter's input, a thick line for its result, a thin one for the truth."""
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


def plot(name: str, columns: Collection[str]) -> Node | None:
    """A plot of the curves that are in ``columns``; None if there are none."""
    title, unit, labels = _PLOTS[name]
    coloured = zip(labels.items(), (_BLUE, _ORANGE, _GREEN), strict=False)
    paths = [
        _path(METRICS_TOPIC, metric, label, color=colour, showLine=True, lineSize=_THICK) | _STYLES.get(label, {})
        for (metric, label), colour in coloured
        if metric in columns
    ]
    return _plot(name, title, unit, paths)


def stage_times(columns: Collection[str]) -> Node | None:
    """A plot of stage times in milliseconds, for the stages in ``columns``."""
    stages = [column.removesuffix("_ms") for column in TIME_COLUMNS if column in columns]
    paths = [
        _path(TIMES_TOPIC, f"{stage}_ms", stage, color=STAGE_COLOURS[stage], showLine=True, lineSize=_THIN)
        for stage in stages
    ]
    return _plot("times", "Time per stage, ms (live only)", "ms", paths)


def _plot(name: str, title: str, unit: str, paths: list[Config]) -> Node | None:
    shown = {
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "left",
        "showPlotValuesInLegend": False,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": _LEGEND_WIDTH_PX,
        "yAxisLabel": unit,
    }
    return panel("Plot", name, title, paths=paths, **shown) if paths else None


def _path(topic: str, metric: str, label: str, **style: object) -> Config:
    return {"value": f"{topic}.{metric}", "enabled": True, "label": label, "timestampMethod": "receiveTime", **style}


def states(name: str, title: str, labels: Mapping[str, str], columns: Collection[str]) -> Node | None:
    """Bars of states over time, for the metrics in ``columns``."""
    paths = [_path(METRICS_TOPIC, metric, label) for metric, label in labels.items() if metric in columns]
    return panel("StateTransitions", name, title, isSynced=True, paths=paths) if paths else None
