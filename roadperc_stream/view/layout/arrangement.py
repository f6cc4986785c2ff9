"""What stands where: the camera's image large, the scene beside it, other pictures and numbers below."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from roadperc_stream.model import EGO
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.schemas.topics import (
    DRIVABLE_SCENE_TOPIC,
    DRIVABLE_TOPIC,
    LANES_ANNOTATIONS_TOPIC,
    LANES_SCENE_TOPIC,
    LANES_TOPIC,
    LOG_TOPIC,
    OBJECTS_ANNOTATIONS_TOPIC,
    OBJECTS_SCENE_TOPIC,
    OBJECTS_TOPIC,
    OCCUPANCY_TOPIC,
    ODOMETRY_TOPIC,
    ON_REQUEST,
    RESULT_PREFIX,
    STEREO_DEPTH_TOPIC,
    SURFACE_TOPIC,
    TF_TOPIC,
    TIMES_TOPIC,
    TRAJECTORY_TOPIC,
)
from roadperc_stream.system.files import completing, require_free
from roadperc_stream.view.layout import curves
from roadperc_stream.view.layout.contents import OF_A_LIVE_REPLAY, LogContents, contents_of
from roadperc_stream.view.layout.panels import (
    PRELOADED,
    ROWS,
    Config,
    Node,
    Panel,
    Script,
    column,
    depth_picture,
    detections_table,
    layout_json,
    objects_table,
    picture,
    raw_messages,
    row,
    table,
    tabs,
    titled,
    words,
)

_IN_THE_IMAGE: Final = (LANES_ANNOTATIONS_TOPIC, OBJECTS_ANNOTATIONS_TOPIC)
_IN_SPACE: Final[Mapping[str, Config]] = {
    DRIVABLE_SCENE_TOPIC: {},
    LANES_SCENE_TOPIC: {},
    OBJECTS_SCENE_TOPIC: {},
    OCCUPANCY_TOPIC: {
        "frameLocked": True,
        "colorMode": "custom",
        "minColor": "#1e82dc50",
        "maxColor": "#e0403ac0",
        "unknownColor": "#00000000",
        "invalidColor": "#00000000",
        "alpha": 0.6,
    },
    TRAJECTORY_TOPIC: {"type": "line", "lineWidth": 0.25, "gradient": ["#f0c419ff", "#f0c419ff"]},
    ODOMETRY_TOPIC: {"type": "axis", "axisScale": 1},
    TF_TOPIC: {},
}
"""Results in the scene, and how they are drawn."""
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
_ALWAYS_TIMED: Final = tuple(f"{part}_ms" for part in ("read", "decode", "metrics", "copy", "encode", "write", "total"))
_OUTPUT_OF: Final = {
    "surface_ms": SURFACE_TOPIC,
    "lanes_ms": LANES_TOPIC,
    "objects_ms": OBJECTS_TOPIC,
    "stereo_ms": STEREO_DEPTH_TOPIC,
    "odometry_ms": ODOMETRY_TOPIC,
    "occupancy_ms": OCCUPANCY_TOPIC,
}
"""By the columns of times what tells whether the stage ran."""


def layout_of(has: LogContents) -> str:
    """The layout of a log as JSON."""
    left = column(_camera(has), _other_pictures(has), first_percent=60)
    right = column(_scene(has), _numbers(has), first_percent=46)
    return layout_json(row(left, right, first_percent=46), _scripts(has))


def _camera(has: LogContents) -> Node | None:
    """The camera the results are of with what was found drawn over it, the pictures of the stages, other cameras."""
    front = _front(has)
    drawn = [has.result(topic) for topic in _IN_THE_IMAGE]
    camera = "Drivable" if front == DRIVABLE_TOPIC else "Front camera"
    shown = picture("front", f"{camera}: lanes and objects" if any(drawn) else camera, front, drawn)
    made = {topic.rpartition("/")[2].capitalize(): has.result(topic) for topic in ON_REQUEST}
    others = {side.capitalize(): has.roles.get(side) for side in ("left", "right") if has.roles.get(side) != front}
    named = made | others | {topic: topic for topic in has.more_images}
    pictures = {title: picture(title.lower(), title, topic) for title, topic in named.items()}
    return tabs("front", {"Camera": shown, **pictures})


def _front(has: LogContents) -> str | None:
    """What lanes and objects are drawn over: the results of a log without its images are drawn over the road."""
    return has.roles.get("image") or has.roles.get("left") or has.result(DRIVABLE_TOPIC)


def _other_pictures(has: LogContents) -> Node | None:
    """Tags and depth, what was made of them, and what is true of them."""
    roles = has.roles
    tags = picture("tags", "Tags", roles.get("segmentation"))
    drivable = None if _front(has) == DRIVABLE_TOPIC else picture("drivable", "Drivable", has.result(DRIVABLE_TOPIC))
    stereo = depth_picture("stereo", "Stereo depth", has.result(STEREO_DEPTH_TOPIC))
    true_tags = picture("true_tags", "True tags", roles.get("truth_segmentation"))
    return tabs(
        "pictures",
        _named(
            {
                ("Tags", "depth"): (tags, _depth(has, "depth", "Depth")),
                ("Instances",): (picture("instances", "Instances", roles.get("instances")),),
                ("Drivable", "stereo"): (drivable, stereo),
                ("True tags", "true depth"): (true_tags, _depth(has, "truth_depth", "True depth")),
            }
        ),
    )


def _named(pairs: Mapping[tuple[str, ...], tuple[Panel | None, ...]]) -> dict[str, Node | None]:
    """Rows of panels by a title that names those that are there."""
    rows = {}
    for names, panels in pairs.items():
        title = ", ".join(name for name, panel in zip(names, panels, strict=True) if panel)
        rows[title.capitalize() if title else ", ".join(names)] = row(*panels)
    return rows


def _depth(has: LogContents, role: str, title: str) -> Panel | None:
    topic = has.roles.get(role)
    return depth_picture(role, title, topic, in_metres=topic in has.depth_in_metres)


def _scene(has: LogContents) -> Panel | None:
    """All that has a place in space, seen from behind the car."""
    drawn = {topic: _IN_SPACE[topic] for topic in _IN_SPACE if topic in has.results}
    drawn |= {has.roles[role]: _ROLES_IN_SPACE[role] for role in _ROLES_IN_SPACE if role in has.roles}
    if not drawn:
        return None
    followed = {"followMode": "follow-pose", "followTf": EGO} if has.has_ego_frame else {"followMode": "follow-pose"}
    transforms = {"showLabel": False, "axisScale": 0.6, "lineWidth": 0, **PRELOADED}
    config: Config = {
        "cameraState": _CAMERA,
        **followed,
        "scene": {"transforms": transforms, "labelScaleFactor": 1},
        "transforms": {},
        "topics": {topic: {"visible": True, **how} for topic, how in drawn.items()},
        "layers": {},
    }
    title = "Road, lanes, objects, occupancy, trajectory" if has.results else "Scene"
    return Panel("3D", "scene", {**config, **titled(title)})


def _numbers(has: LogContents) -> Node | None:
    """Plots of the metrics, states, and results in words."""
    shown = has.columns
    return tabs(
        "numbers",
        {
            "Lanes": _lanes(has),
            "Objects": column(_objects(has), row(*_plots(has, curves.NEAREST, curves.OBJECT_ERRORS)), first_percent=58),
            "Motion": column(*_plots(has, curves.MOTION, curves.MOTION_ERRORS, curves.COUNTS), first_percent=34),
            "Road": column(
                row(*_plots(has, curves.CAMERA, curves.SURFACE_ERRORS)),
                row(*_plots(has, curves.SHARES, curves.SCORES)),
            ),
            "States": row(
                curves.states("states", "States", curves.STATES, shown),
                curves.states("lane_states", "Boundaries", curves.BOUNDARY_STATES, shown),
            ),
            "Times": _times(has),
            "Log": words("log", "Log: what was missing", has.result(LOG_TOPIC)),
            "Messages": _messages(has),
        },
    )


def _lanes(has: LogContents) -> Node | None:
    """The offset of each boundary, and its error beside it where the truth is known."""
    left = _plots(has, curves.LEFT_OFFSET, curves.LEFT_ERROR)
    right = _plots(has, curves.RIGHT_OFFSET, curves.RIGHT_ERROR)
    lane = curves.plot(curves.LANE, has.columns)
    return column(row(*left, first_percent=58), row(*right, first_percent=58), lane, first_percent=37)


def _plots(has: LogContents, *described: curves.Plot) -> list[Panel | None]:
    return [curves.plot(one, has.columns) for one in described]


def _objects(has: LogContents) -> Panel | None:
    """The objects in words; the detections of a log without any."""
    return next((table(script.name, title, f"{script.output}.{ROWS}") for title, script in _tables(has)), None)


def _tables(has: LogContents) -> Iterable[tuple[str, Script]]:
    if OBJECTS_TOPIC in has.results:
        yield "Objects", objects_table(OBJECTS_TOPIC)
    elif "detections" in has.roles:
        yield "Detections", detections_table(has.roles["detections"])


def _scripts(has: LogContents) -> list[Script]:
    return [script for _, script in _tables(has)]


def _times(has: LogContents) -> Panel | None:
    """Of the stages that ran, where a server knows the times: no log has them."""
    if TIMES_TOPIC not in has.results:
        return None
    ran = {column for column, topic in _OUTPUT_OF.items() if topic in has.results}
    return curves.plot(curves.stage_times(), ran | set(_ALWAYS_TIMED))


def _messages(has: LogContents) -> Node | None:
    """Results as they are written; without results the truths of an input log."""
    results = [
        raw_messages(name.replace("/", "_"), name.capitalize(), has.result(f"{RESULT_PREFIX}{name}"))
        for name in ("surface", "lanes", "odometry/state", "metrics")
    ]
    truths = [raw_messages(name, ROLES[name].topic, has.roles.get(name)) for name in ("truth_surface", "truth_lanes")]
    first, second = (results[:2], results[2:]) if any(results) else (truths[:1], truths[1:])
    return row(column(*first), column(*second))


_NO_OVERRIDES: Final[Mapping[str, str]] = {}


def write_layout(
    target: Path,
    source: Path | None = None,
    overrides: Mapping[str, str] = _NO_OVERRIDES,
    *,
    timed: bool = False,
    force: bool,
) -> None:
    """Write the layout to a file for the viewers' "import from file".

    Args:
        target: the file, ``.json``.
        source: the log it is for; None for a replay that is served live and has all this project's own topics.
        overrides: topic of each role of ``source`` that another topic fills than the one found.
        timed: the log is served live with the times of its stages, which it does not hold itself.
        force: replace an existing file.

    Raises:
        RoadpercError: the log cannot be read or holds nothing to show, or the file's name is taken, or it
            cannot be written.
    """
    require_free(target, force=force, source=source, suffix=".json")
    has = contents_of(source, overrides) if source else OF_A_LIVE_REPLAY
    layout = layout_of(has.with_times() if timed else has)
    with completing(target, force=force) as temporary:
        temporary.write_text(layout, "utf-8")
