"""Arranges the panels of the Rerun viewer: image with overlays, 3D scene beside it, plots and log below."""

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Final

import rerun as rr
import rerun.blueprint as rrb

from roadperc_stream.model import EGO
from roadperc_stream.schemas import topics
from roadperc_stream.view.rerun.scene import MISSING, STATES
from roadperc_stream.view.rerun.tree import TREE

_IN_THE_IMAGE: Final = (topics.LANES_ANNOTATIONS_TOPIC, topics.OBJECTS_ANNOTATIONS_TOPIC)
_IN_SPACE: Final = (
    topics.SURFACE_TOPIC,
    topics.DRIVABLE_SCENE_TOPIC,
    topics.LANES_SCENE_TOPIC,
    topics.OBJECTS_SCENE_TOPIC,
    topics.OCCUPANCY_TOPIC,
    topics.ODOMETRY_TOPIC,
    topics.TRAJECTORY_TOPIC,
    topics.TF_TOPIC,
)
_FRONT_CAMERA: Final = ("calibration", "left_calibration", "depth_calibration")
"""Roles of which the first one draws the image plane, if they have the same frame and pixels."""
_CURVES: Final[Mapping[str, tuple[str, ...]]] = {
    "lane offsets, m": (
        "lane_left_offset_m",
        "lane_left_raw_offset_m",
        "lane_right_offset_m",
        "lane_right_raw_offset_m",
    ),
    "nearest object, m; time to impact, s": ("nearest_object_m", "time_to_impact_s"),
    "motion": ("step_m", "turn_deg"),
    "odometry inliers": ("odometry_inliers",),
    "road": ("camera_pitch_deg", "camera_roll_deg", "camera_height_m", "surface_inlier_ratio"),
    "errors of road and depth": ("surface_angle_error_deg", "camera_height_error_m", "stereo_epe_px", "stereo_abs_rel"),
    "errors, m": ("lane_left_error_m", "lane_right_error_m", "object_distance_error_m", "step_error_m"),
}
"""Titles of the plots and their metrics."""
_COLOURS: Final = {
    "lane_left_offset_m": (26, 230, 77),
    "lane_left_raw_offset_m": (150, 170, 60),
    "lane_right_offset_m": (26, 160, 255),
    "lane_right_raw_offset_m": (90, 120, 170),
    "nearest_object_m": (255, 170, 0),
    "time_to_impact_s": (255, 80, 80),
}
STAGE_COLOURS: Final = {
    "total": 0x8C8C8CFF,
    "decode": 0x4E98E2FF,
    "surface": 0xF5774DFF,
    "lanes": 0x3FAE49FF,
    "objects": 0xF0C419FF,
    "stereo": 0xB07AA1FF,
    "odometry": 0xE15759FF,
    "occupancy": 0x76B7B2FF,
    "encode": 0x9C755FFF,
    "read": 0xA0CBE8FF,
    "metrics": 0xD4A6C8FF,
    "copy": 0x8CD17DFF,
    "write": 0xD7B5A6FF,
}
"""Red, green, blue, opacity of the stages' times, as in the Foxglove layout."""
_WIDTHS: Final = (4.0, 2.0, 3.5)
_SMOOTHED_WIDTH: Final = 2.0
_RAW_WIDTH: Final = 0.8
_EYE: Final = rrb.EyeControls3D(position=(-10.0, 0.0, 7.0), look_target=(12.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Log:
    """The contents of a log: the topic of each role, and every entity."""

    topics: Mapping[str, str]
    entities: Set[str]
    root: str = ""
    """Parent of the entities in the recording."""

    def has(self, entity: str) -> bool:
        """Whether the log has an entity or one below it."""
        return any(known == entity or known.startswith(f"{entity}/") for known in self.entities)

    def present(self, entities: Iterable[str | None]) -> list[str]:
        """The entities that the log has."""
        return [entity for entity in entities if entity is not None and self.has(entity)]


def blueprint(log: Log, time_panel: rrb.TimePanel) -> rrb.Blueprint:
    """Panels for the contents of the log, without empty ones."""
    pictures = _row(_WIDTHS, in_tabs(_front(log)), _aside(log), _space(log))
    rows = [pictures, _row((1.0, 1.0, 1.0), *_numbers(log))]
    return arranged([row for row in rows if row is not None], time_panel)


def arranged(rows: Sequence[rrb.Container], time_panel: rrb.TimePanel) -> rrb.Blueprint:
    """At most two rows of panels above the time panel; without rows, the viewer chooses the panels."""
    return rrb.Blueprint(
        rrb.Vertical(*rows, row_shares=[2.0, 1.0][: len(rows)]),
        time_panel,
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=not rows,
    )


def _row(widths: Iterable[float], *parts: rrb.Container | rrb.View | None) -> rrb.Container | None:
    shown = [(part, width) for part, width in zip(parts, widths, strict=False) if part is not None]
    shares = [width for _, width in shown]
    return rrb.Horizontal(*(part for part, _ in shown), column_shares=shares) if shown else None


def in_tabs(views: list[rrb.View]) -> rrb.Container | rrb.View | None:
    """The views as tabs; None without views."""
    return rrb.Tabs(*views, active_tab=0) if len(views) > 1 else next(iter(views), None)


def _front(log: Log) -> list[rrb.View]:
    """The image with results or detections; without an image, the tags or the depth; then the pictures on request."""
    results, inputs = log.present(_IN_THE_IMAGE), log.present([log.topics.get("detections")])
    name = "image and results" if results else "image and detections" if inputs else "image"
    made = sorted(e for e in log.entities if e.startswith((topics.OVERLAY_TOPIC, topics.DEBUG_PREFIX)))
    pictures = picture_with_results(name, log, log)
    return pictures + [_picture(entity.rpartition("/")[2], entity) for entity in made]


def picture_with_results(name: str, of_image: Log, log: Log) -> list[rrb.View]:
    """The image of a log, or its tags or depth, with results or detections of the same or another log; at most one."""
    under = of_image.present(map(of_image.topics.get, ("image", "left", "segmentation", "depth")))[:1]
    over = log.present(_IN_THE_IMAGE) or log.present([log.topics.get("detections")])
    parts = tuple(f"{log.root}{entity}" for entity in over)
    return [_picture(name, f"{of_image.root}{entity}", parts) for entity in under]


def _aside(log: Log) -> rrb.Container | None:
    """Tags and depth, with the results from them as further tabs."""
    tags = {"tags": log.topics.get("segmentation"), "drivable": topics.DRIVABLE_TOPIC}
    depth = {"depth": log.topics.get("depth"), "stereo depth": topics.STEREO_DEPTH_TOPIC}
    more = {"left": log.topics.get("left"), "right": log.topics.get("right")}
    stacks = [in_tabs(_named(log, names)) for names in (tags, depth | more)]
    return rrb.Vertical(*shown) if (shown := [stack for stack in stacks if stack is not None]) else None


def _named(log: Log, entities: Mapping[str, str | None]) -> list[rrb.View]:
    return [
        _picture(name, entity) for name, entity in entities.items() if entity is not None and entity in log.entities
    ]


def _picture(name: str, entity: str, over: tuple[str, ...] = ()) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(origin=entity, name=name, contents=[entity, *(f"{part}/**" for part in over)])


def _space(log: Log) -> rrb.View | None:
    """The 3D scene from behind and above the car; depth, or stereo depth, as points."""
    depth = log.present([log.topics.get("depth"), topics.STEREO_DEPTH_TOPIC])[:1]
    inputs = log.present(log.topics.get(role) for role in ("image", "lidar", "truth_lanes"))
    camera = log.present(log.topics.get(role) for role in _FRONT_CAMERA)[:1]
    parts = [*depth, *inputs, *camera, *log.present([TREE]), *log.present(_IN_SPACE)]
    if not (depth or log.present(_IN_SPACE) or log.has(log.topics.get("lidar", "?"))):
        return None
    return rrb.Spatial3DView(
        origin="/",
        name="scene (car's frame)",
        contents=[f"{part}/**" for part in parts],
        spatial_information=rrb.SpatialInformation(target_frame=EGO),
        eye_controls=_EYE,
        line_grid=False,
    )


def _numbers(log: Log) -> tuple[rrb.Container | rrb.View | None, ...]:
    """Lane offsets; all other metrics; times, states and log lines."""
    plots = {title: _plot(log, title, names) for title, names in _CURVES.items()}
    lanes = plots.pop("lane offsets, m")
    return lanes, in_tabs([plot for plot in plots.values() if plot is not None]), in_tabs(_times_and_texts(log))


def _plot(log: Log, title: str, names: tuple[str, ...]) -> rrb.View | None:
    entities = {f"{topics.METRICS_TOPIC}/{name}": name for name in names}
    lines = {e: _line(name) if name in _COLOURS else None for e, name in entities.items() if e in log.entities}
    return curves(title, lines) if lines else None


def _line(name: str) -> rr.SeriesLines:
    short = name.removeprefix("lane_").replace("_offset_m", "").replace("_", " ")
    width = _RAW_WIDTH if "_raw_" in name else _SMOOTHED_WIDTH
    return rr.SeriesLines(colors=_COLOURS[name], widths=width, names=short)


def _times(log: Log) -> rrb.View:
    """Milliseconds of the stages that ran; the labels are short because the legend covers the curves."""
    lines: dict[str, rr.SeriesLines | None] = {}
    for stage, colour in STAGE_COLOURS.items():
        if (entity := f"{topics.TIMES_TOPIC}/{stage}_ms") in log.entities:
            width = _RAW_WIDTH if stage == "total" else _SMOOTHED_WIDTH
            lines[entity] = rr.SeriesLines(colors=colour, widths=width, names=stage)
    return curves("time per stage, ms", lines)


def curves(title: str, lines: Mapping[str, rr.SeriesLines | rr.SeriesPoints | None]) -> rrb.View:
    """Curves over time by entity; the viewer chooses the style of those with None."""
    return rrb.TimeSeriesView(
        name=title,
        contents=[*lines],
        overrides={entity: line for entity, line in lines.items() if line is not None},
        plot_legend=rrb.Corner2D.RightTop,
    )


def _times_and_texts(log: Log) -> list[rrb.View]:
    views: list[rrb.View] = []
    if log.has(topics.TIMES_TOPIC):
        views.append(_times(log))
    metrics = sorted(entity for entity in log.entities if entity.startswith(topics.METRICS_TOPIC))
    if states := [entity for entity in metrics if entity.endswith((*STATES, MISSING))]:
        views.append(rrb.StateTimelineView(name="states", contents=states))
    if lines := log.present((topics.LOG_TOPIC, f"{topics.METRICS_TOPIC}/reasons")):
        views.append(rrb.TextLogView(name="log", contents=lines))
    return views
