"""Arranges the panels: the camera image and the scene on top, other pictures and numbers below."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from roadperc_stream.log import AnyLog, LogFile
from roadperc_stream.model import EGO
from roadperc_stream.schemas import topics
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.files import completing, require_free
from roadperc_stream.view.layout.contents import OF_A_LIVE_REPLAY, LogContents, contents_of
from roadperc_stream.view.layout.curves import BOUNDARY_STATES, STATES, plot, stage_times, states
from roadperc_stream.view.layout.panels import PRELOADED, Config, Node, column, panel, picture, row, tabs
from roadperc_stream.view.layout.tables import detections_table, objects_table

_IN_THE_IMAGE: Final = (topics.LANES_ANNOTATIONS_TOPIC, topics.OBJECTS_ANNOTATIONS_TOPIC)
_IN_SPACE: Final[Mapping[str, Config]] = {
    topics.DRIVABLE_SCENE_TOPIC: {},
    topics.LANES_SCENE_TOPIC: {},
    topics.OBJECTS_SCENE_TOPIC: {},
    topics.OCCUPANCY_TOPIC: {
        "frameLocked": True,
        "colorMode": "custom",
        "minColor": "#1e82dc50",
        "maxColor": "#e0403ac0",
        "unknownColor": "#00000000",
        "invalidColor": "#00000000",
        "alpha": 0.6,
    },
    topics.TRAJECTORY_TOPIC: {"type": "line", "lineWidth": 0.25, "gradient": ["#f0c419ff", "#f0c419ff"]},
    topics.ODOMETRY_TOPIC: {"type": "axis", "axisScale": 1},
    topics.TF_TOPIC: {},
}
"""Results in the scene and their styles."""
_ROLES_IN_SPACE: Final[Mapping[str, Config]] = {
    "tf": {},
    "tf_static": {},
    "calibration": {"distance": 3, "width": 0.02, "color": "#7c6bffff"},
    "lidar": {"pointSize": 2, "colorMode": "colormap", "colorMap": "turbo", "colorField": "x"},
}
_CAMERA: Final[Config] = {
    "distance": 22,
    "perspective": True,
    "phi": 64,
    "target": [0, 0, 0],
    "targetOffset": [9, 0, 0],
    "targetOrientation": [0, 0, 0, 1],
    "thetaOffset": 90,
    "fovy": 45,
    "near": 0.5,
    "far": 5000,
}
"""From behind and above the car."""
_MOST_DEPTH_M: Final = 60
_MM_PER_M: Final = 1000
_ALWAYS_TIMED: Final = tuple(f"{part}_ms" for part in ("read", "decode", "metrics", "copy", "encode", "write", "total"))
_OUTPUT_OF: Final = {
    "surface_ms": topics.SURFACE_TOPIC,
    "lanes_ms": topics.LANES_TOPIC,
    "objects_ms": topics.OBJECTS_TOPIC,
    "stereo_ms": topics.STEREO_DEPTH_TOPIC,
    "odometry_ms": topics.ODOMETRY_TOPIC,
    "occupancy_ms": topics.OCCUPANCY_TOPIC,
}
"""The output topic of each time column; it shows whether the stage ran."""


def layout_of(has: LogContents) -> str:
    """The layout of a log as JSON."""
    table, script = _table(has)
    left = column(_camera(has), _other_pictures(has), first_percent=60)
    right = column(_scene(has), _numbers(has, table), first_percent=46)
    root = row(left, right, first_percent=46)
    layout: Config = {
        "configById": dict(root.configs) if root else {},
        "globalVariables": {},
        "userNodes": {script["name"]: script} if script else {},
        "playbackConfig": {"speed": 1},
    }
    if root:
        layout["layout"] = root.place
    return json.dumps(layout, indent=2, ensure_ascii=False) + "\n"


def _camera(has: LogContents) -> Node | None:
    """Tabs: the camera image with results, pictures of the stages, other cameras."""
    front = _front(has)
    drawn = [topic for topic in _IN_THE_IMAGE if topic in has.results]
    camera = "Drivable" if front == topics.DRIVABLE_TOPIC else "Front camera"
    shown = picture("front", f"{camera}: lanes and objects" if drawn else camera, front, drawn)
    made = {topic.rpartition("/")[2].capitalize(): has.result(topic) for topic in topics.ON_REQUEST}
    others = {side.capitalize(): has.roles.get(side) for side in ("left", "right") if has.roles.get(side) != front}
    named = made | others | {topic: topic for topic in has.more_images}
    pictures = {title: picture(title.lower(), title, topic) for title, topic in named.items()}
    return tabs("front", {"Camera": shown, **pictures})


def _front(has: LogContents) -> str | None:
    """The picture under lanes and objects: the camera image, or the drivable mask in a log without images."""
    return has.roles.get("image") or has.roles.get("left") or has.result(topics.DRIVABLE_TOPIC)


def _other_pictures(has: LogContents) -> Node | None:
    """Tabs: tags and depth, the results from them, and their truth."""
    roles = has.roles
    drivable = None if _front(has) == topics.DRIVABLE_TOPIC else has.result(topics.DRIVABLE_TOPIC)
    pairs = (
        {
            "Tags": picture("tags", "Tags", roles.get("segmentation")),
            "Depth": _depth(has, "depth", "Depth", roles.get("depth")),
        },
        {"Instances": picture("instances", "Instances", roles.get("instances"))},
        {
            "Drivable": picture("drivable", "Drivable", drivable),
            "Stereo": _depth(has, "stereo", "Stereo depth", has.result(topics.STEREO_DEPTH_TOPIC)),
        },
        {
            "True tags": picture("true_tags", "True tags", roles.get("truth_segmentation")),
            "True depth": _depth(has, "truth_depth", "True depth", roles.get("truth_depth")),
        },
    )
    titles = [", ".join(name for name, panel in pair.items() if panel).capitalize() for pair in pairs]
    return tabs("pictures", {title: row(*pair.values()) for title, pair in zip(titles, pairs, strict=True)})


def _depth(has: LogContents, name: str, title: str, topic: str | None) -> Node | None:
    """A coloured depth image, red at the far end."""
    most = _MOST_DEPTH_M if topic in has.depth_in_metres else _MOST_DEPTH_M * _MM_PER_M
    colours: Config = {"colorMode": "colormap", "colorMap": "turbo", "minValue": 0, "maxValue": most}
    return picture(name, f"{title}, 0 to {_MOST_DEPTH_M} m", topic, **colours)


def _scene(has: LogContents) -> Node | None:
    """The 3D scene, seen from behind the car."""
    drawn = {topic: style for topic, style in _IN_SPACE.items() if topic in has.results}
    drawn |= {has.roles[role]: style for role, style in _ROLES_IN_SPACE.items() if role in has.roles}
    if not drawn:
        return None
    transforms = {"showLabel": False, "axisScale": 0.6, "lineWidth": 0, **PRELOADED}
    return panel(
        "3D",
        "scene",
        "Road, lanes, objects, occupancy, trajectory" if has.results else "Scene",
        cameraState=_CAMERA,
        followMode="follow-pose",
        **({"followTf": EGO} if has.has_ego_frame else {}),
        scene={"transforms": transforms, "labelScaleFactor": 1},
        transforms={},
        topics={topic: {"visible": True, **style} for topic, style in drawn.items()},
        layers={},
    )


def _numbers(has: LogContents, table: Node | None) -> Node | None:
    """Tabs: plots of the metrics, states, stage times, log lines and messages."""
    return tabs(
        "numbers",
        {
            "Lanes": column(
                row(*_plots(has, "left_offset", "left_error"), first_percent=58),
                row(*_plots(has, "right_offset", "right_error"), first_percent=58),
                *_plots(has, "lane"),
                first_percent=37,
            ),
            "Objects": column(table, row(*_plots(has, "objects", "object_errors")), first_percent=58),
            "Motion": column(*_plots(has, "odometry", "odometry_errors", "inliers"), first_percent=34),
            "Road": column(row(*_plots(has, "surface", "surface_errors")), row(*_plots(has, "shares", "scores"))),
            "States": row(
                states("states", "States", STATES, has.columns),
                states("lane_states", "Boundaries", BOUNDARY_STATES, has.columns),
            ),
            "Times": _times(has),
            "Log": _log(has),
            "Messages": _messages(has),
        },
    )


def _plots(has: LogContents, *names: str) -> list[Node | None]:
    return [plot(name, has.columns) for name in names]


def _table(has: LogContents) -> tuple[Node | None, Config | None]:
    """The table of objects, or of detections in a log without results, and its script."""
    if topics.OBJECTS_TOPIC in has.results:
        return objects_table(topics.OBJECTS_TOPIC)
    return detections_table(has.roles["detections"]) if "detections" in has.roles else (None, None)


def _times(has: LogContents) -> Node | None:
    """The times of the stages that ran, if a server provides them; logs do not contain them."""
    ran = {column for column, topic in _OUTPUT_OF.items() if topic in has.results}
    return stage_times(ran | set(_ALWAYS_TIMED)) if topics.TIMES_TOPIC in has.results else None


def _log(has: LogContents) -> Node | None:
    shown: Config = {"searchTerms": [], "minLogLevel": 1, "topicToRender": topics.LOG_TOPIC}
    return panel("RosOut", "log", "Log: what was missing", **shown) if topics.LOG_TOPIC in has.results else None


def _messages(has: LogContents) -> Node | None:
    """Result messages as trees; the truth of an input log if it has no results."""
    results = [
        _raw_messages(name.replace("/", "_"), name.capitalize(), has.result(f"{topics.RESULT_PREFIX}{name}"))
        for name in ("surface", "lanes", "odometry/state", "metrics")
    ]
    truths = [_raw_messages(name, ROLES[name].topic, has.roles.get(name)) for name in ("truth_surface", "truth_lanes")]
    first, second = (results[:2], results[2:]) if any(results) else (truths[:1], truths[1:])
    return row(column(*first), column(*second))


def _raw_messages(name: str, title: str, topic: str | None) -> Node | None:
    """The messages of a topic as a collapsible tree."""
    if topic is None:
        return None
    shown: Config = {"topicPath": topic, "expansion": "none", "showFullMessageForDiff": False}
    difference = {"diffEnabled": False, "diffMethod": "previous message", "diffTopicPath": ""}
    return panel("RawMessages", name, title, **shown, **difference)


def write_layout(
    target: Path,
    source: AnyLog | None = None,
    overrides: Mapping[str, str] | None = None,
    *,
    timed: bool = False,
    force: bool,
) -> None:
    """Write the layout to a file for the viewers' "import from file".

    ``target`` ends with ``.json``. ``source`` is None for a replay that is served live and has all this project's own
    topics. ``overrides`` are topics by role; ``timed`` logs are served live with stage times.

    Raises:
        RoadpercError: the log cannot be read or has nothing to show, or the file exists or cannot be
            written.
    """
    require_free(target, force=force, source=LogFile.of(source).name if source else None, suffix=".json")
    has = contents_of(source, overrides or {}) if source else OF_A_LIVE_REPLAY
    if timed:
        has = replace(has, results=has.results | {topics.TIMES_TOPIC})
    with completing(target, force=force) as temporary:
        temporary.write_text(layout_of(has), "utf-8")
