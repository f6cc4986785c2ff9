"""Fills the layout template with the topics of a log, and leaves out the panels that have nothing to show."""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from roadperc_stream.log import AnyLog, LogFile
from roadperc_stream.schemas import topics
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.files import require_free, write_whole
from roadperc_stream.view.layout.contents import OF_A_LIVE_REPLAY, LogContents, contents_of

Config = dict[str, Any]
"""Settings as the viewers store them."""
Place = Config | str
"""The key of a panel or of tabs, or a split into two parts beside or above each other."""
_TABLES: Final = {"objects_table": topics.OBJECTS_TOPIC, "detections_table": ROLES["detections"].topic}
"""The scripts that make tables, and their topics; a layout has the first one that has messages."""
_RAW_TRUTH: Final = (ROLES["truth_surface"].topic, ROLES["truth_lanes"].topic)
"""Truth that has a panel only in a log without results."""
_WRITES: Final = {
    "surface_ms": topics.SURFACE_TOPIC,
    "lanes_ms": topics.LANES_TOPIC,
    "objects_ms": topics.OBJECTS_TOPIC,
    "stereo_ms": topics.STEREO_DEPTH_TOPIC,
    "odometry_ms": topics.ODOMETRY_TOPIC,
    "occupancy_ms": topics.OCCUPANCY_TOPIC,
}
"""The topic that a timed stage writes; it shows whether the stage ran. The other times are always known."""
_MM_PER_M: Final = 1000


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
        RoadpercError: the log cannot be read or has nothing to show, or the file exists or cannot be written.
    """
    require_free(target, force=force, source=LogFile.of(source).name if source else None, suffix=".json")
    has = contents_of(source, overrides or {}) if source else OF_A_LIVE_REPLAY
    if timed:
        has = replace(has, results=has.results | {topics.TIMES_TOPIC})
    write_whole(target, layout_of(has), force=force)


def layout_of(has: LogContents) -> str:
    """The layout of a log as JSON."""
    layout: Config = json.loads(_file("template.json"))
    panels: dict[str, Config] = layout["configById"]
    for topic in has.more_images:
        panels[f"Image!{topic}"] = {"imageMode": {"imageTopic": topic, "synchronize": False}, **_titled(topic)}
        panels["Tab!front"]["tabs"].append({"title": topic, "layout": f"Image!{topic}"})
    filling = _Filling(has)
    layout["userNodes"] = filling.scripts
    filled = {key: config for key, config in panels.items() if filling.fills(key, config)}
    shown: dict[str, Config] = {}
    layout["configById"] = shown
    place = _arranged(layout.pop("layout"), filled, shown)
    return json.dumps(layout | ({"layout": place} if place else {}), indent=2, ensure_ascii=False) + "\n"


def _file(name: str) -> str:
    return files(__package__).joinpath(name).read_text("utf-8")


def _titled(title: str) -> Config:
    """The settings for a title, which each viewer stores under its own key."""
    return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}


class _Filling:
    """Puts the topics of a log into panels of the template."""

    def __init__(self, has: LogContents) -> None:
        self._has = has
        topic_of = {ROLES[role].topic: topic for role, topic in has.roles.items()}
        topic_of |= {topic: topic for topic in (*has.results, *has.more_images)}
        front = has.roles.get("image") or has.roles.get("left") or topic_of.get(topics.DRIVABLE_TOPIC)
        if front is not None:  # lanes and objects are drawn over it
            topic_of[ROLES["image"].topic] = front
        raw = {name: topic for name, topic in topic_of.items() if not (has.results and name in _RAW_TRUTH)}
        self._topic_of, self._raw_topic_of, self._pictured = topic_of, raw, set[str]()
        table = next((name for name, topic in _TABLES.items() if topic in topic_of), None)
        self.scripts = {table: {"name": table, "sourceCode": self._script(table)}} if table else {}
        """The script of the table, as the viewers store it."""

    def _script(self, table: str) -> str:
        topic = _TABLES[table]
        return _file(f"{table}.ts").replace(json.dumps(topic), json.dumps(self._topic_of[topic], ensure_ascii=False))

    def fills(self, key: str, config: Config) -> bool:
        """Fill a panel; return whether the log has something to show in it."""
        fill: Mapping[str, Callable[[Config], bool]] = {
            "Tab": lambda _: True,
            "Image": self._fill_image,
            "3D": self._fill_scene,
            "Plot": self._fill_curves,
            "StateTransitions": self._fill_curves,
            "Table": lambda table: any(f"/{name}." in table["topicPath"] for name in self.scripts),
            "RawMessages": self._fill_messages,
            "RosOut": lambda lines: lines["topicToRender"] in self._topic_of,
        }
        return fill[key.partition("!")[0]](config)

    def _fill_curves(self, config: Config) -> bool:
        config["paths"] = [path for path in config["paths"] if self._has_value(path["value"])]
        return bool(config["paths"])

    def _fill_messages(self, config: Config) -> bool:
        config["topicPath"] = self._raw_topic_of.get(config["topicPath"])
        return config["topicPath"] is not None

    def _fill_image(self, config: Config) -> bool:
        """Fill an image panel, unless an earlier one has the picture."""
        mode = config["imageMode"]
        topic = self._topic_of.get(mode["imageTopic"])
        if topic is None or topic in self._pictured:
            return False
        self._pictured.add(topic)
        mode["imageTopic"] = topic
        if topic in self._has.depth_in_metres:
            mode["maxValue"] //= _MM_PER_M
        if "annotations" in mode:
            drawn = {over: style for over, style in mode.pop("annotations").items() if over in self._topic_of}
            mode |= {"annotations": drawn} if drawn else {}
            camera, _, results = config["foxglovePanelTitle"].partition(":")
            camera = "Drivable" if topic == topics.DRIVABLE_TOPIC else camera
            config |= _titled(f"{camera}:{results}" if drawn else camera)
        return True

    def _fill_scene(self, config: Config) -> bool:
        styles = {self._topic_of.get(topic): style for topic, style in config["topics"].items()}
        config["topics"] = {topic: style for topic, style in styles.items() if topic is not None}
        if not self._has.has_ego_frame:
            del config["followTf"]
        if not self._has.results:
            config |= _titled("Scene")
        return bool(config["topics"])

    def _has_value(self, path: str) -> bool:
        """Whether a plotted value is known in some frame."""
        topic, _, column = path.partition(".")
        if topic == topics.TIMES_TOPIC:
            return topic in self._topic_of and _WRITES.get(column, topic) in self._topic_of
        return column in self._has.columns


def _arranged(place: Place, panels: Mapping[str, Config], shown: dict[str, Config]) -> Place | None:
    """A place without the parts that are not in ``panels``; None if nothing is left.

    Adds the panels and tabs of the place to ``shown``.
    """
    if isinstance(place, str) and place.startswith("Tab!"):
        return _arranged_tabs(place, panels, shown)
    if isinstance(place, str):
        shown |= {place: panels[place]} if place in panels else {}
        return place if place in panels else None
    first, second = (_arranged(place[side], panels, shown) for side in ("first", "second"))
    return {**place, "first": first, "second": second} if first and second else first or second


def _arranged_tabs(key: str, panels: Mapping[str, Config], shown: dict[str, Config]) -> Place | None:
    """The tabs with content; a single one becomes a part without a tab."""
    inside = dict[str, Config]()
    places = ((tab, _arranged(tab["layout"], panels, inside)) for tab in panels[key]["tabs"])
    tabs = [{"title": _tab_title(tab, panels), "layout": place} for tab, place in places if place is not None]
    if len(tabs) < 2:
        shown |= inside
        return tabs[0]["layout"] if tabs else None
    shown |= {key: {**panels[key], "tabs": tabs}, **inside}
    return key


def _tab_title(tab: Config, panels: Mapping[str, Config]) -> str:
    """The title of a tab. A title with a name for each panel, as in "Tags, depth", has only those of shown panels."""
    title, keys = str(tab["title"]), list(_keys(tab["layout"]))
    names = title.split(", ")
    if len(names) != len(keys) or panels.keys() >= set(keys):
        return title
    return ", ".join(name for name, key in zip(names, keys, strict=True) if key in panels).capitalize()


def _keys(place: Place) -> Iterator[str]:
    """The keys of all panels in a place."""
    if isinstance(place, str):
        yield place
    else:
        yield from (key for side in ("first", "second") for key in _keys(place[side]))
