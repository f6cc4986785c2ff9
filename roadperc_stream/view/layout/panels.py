"""Panels of Foxglove and Lichtblick, and how they stand in a window: the JSON of both viewers.

What has nothing to show is None, and rows, columns and tabs close up around it.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from roadperc_stream.schemas import roadperc_pb2 as pb

Config = dict[str, Any]
"""Settings as the viewers store them."""
PRELOADED: Final[Config] = {"enablePreloading": True}
"""Read all transforms first: Lichtblick raises an alert for each panel that does not."""
_EVEN: Final = 50.0
_MOST_DEPTH_M: Final = 60
_MM_PER_M: Final = 1000


@dataclass(frozen=True)
class Panel:
    """A panel of a type that the viewers know; its name tells it from others of its type."""

    kind: str
    name: str
    config: Config

    @property
    def key(self) -> str:
        """By which the arrangement names it."""
        return f"{self.kind}!{self.name}"


@dataclass(frozen=True)
class Split:
    """Two parts, beside each other (``row``) or one above the other (``column``)."""

    direction: str
    first: "Node"
    second: "Node"
    first_percent: float


@dataclass(frozen=True)
class Tabs:
    """Parts of which one is seen at a time."""

    name: str
    parts: tuple[tuple[str, "Node"], ...]
    """Title and content, the one that is open first in front."""

    @property
    def key(self) -> str:
        """By which the arrangement names it."""
        return f"Tab!{self.name}"


Node = Panel | Split | Tabs


@dataclass(frozen=True)
class Script:
    """A program that the viewer runs, which makes a topic of others."""

    name: str
    output: str
    source: str


def row(*parts: Node | None, first_percent: float = _EVEN) -> Node | None:
    """Parts beside each other; all but the first share the rest evenly."""
    return _split("row", parts, first_percent)


def column(*parts: Node | None, first_percent: float = _EVEN) -> Node | None:
    """Parts one above the other; all but the first share the rest evenly."""
    return _split("column", parts, first_percent)


def tabs(name: str, parts: Mapping[str, Node | None]) -> Node | None:
    """Parts by their titles; a single one needs no tab."""
    there = tuple((title, part) for title, part in parts.items() if part is not None)
    return Tabs(name, there) if len(there) > 1 else next((part for _, part in there), None)


def _split(direction: str, parts: Iterable[Node | None], first_percent: float) -> Node | None:
    there = [part for part in parts if part is not None]
    if not there:
        return None
    rest = _split(direction, there[1:], 100 / max(len(there) - 1, 1))
    return Split(direction, there[0], rest, first_percent) if rest else there[0]


def layout_json(root: Node | None, scripts: Iterable[Script]) -> str:
    """The file that both viewers import."""
    layout: Config = {
        "configById": dict(sorted(_configs(root))) if root else {},
        "globalVariables": {},
        "userNodes": {script.name: {"name": script.name, "sourceCode": script.source} for script in scripts},
        "playbackConfig": {"speed": 1},
    }
    if root:
        layout["layout"] = _arranged(root)
    return json.dumps(layout, indent=2, ensure_ascii=False) + "\n"


def _arranged(node: Node) -> Config | str:
    if not isinstance(node, Split):
        return node.key
    return {
        "direction": node.direction,
        "first": _arranged(node.first),
        "second": _arranged(node.second),
        "splitPercentage": node.first_percent,
    }


def _configs(node: Node) -> Iterator[tuple[str, Config]]:
    """The settings of every panel by its key, those in tabs included."""
    if isinstance(node, Split):
        yield from _configs(node.first)
        yield from _configs(node.second)
    elif isinstance(node, Tabs):
        parts = [{"title": title, "layout": _arranged(part)} for title, part in node.parts]
        yield node.key, {"activeTabIdx": 0, "tabs": parts}
        for _, part in node.parts:
            yield from _configs(part)
    else:
        yield node.key, node.config


def titled(title: str) -> Config:
    """A panel's title, under the name that either viewer looks for."""
    return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}


def picture(name: str, title: str, topic: str | None, annotations: Iterable[str | None] = ()) -> Panel | None:
    """An image, with what is drawn over it.

    It names no calibration: images and their annotations need none, and a viewer that draws an image before its
    calibration has come reports an error.
    """
    if topic is None:
        return None
    mode: Config = {"imageTopic": topic, "synchronize": False}
    drawn = {over: {"visible": True} for over in annotations if over}
    if drawn:
        mode["annotations"] = drawn
    return Panel("Image", name, {"imageMode": mode, "scene": {"transforms": dict(PRELOADED)}, **titled(title)})


def depth_picture(name: str, title: str, topic: str | None, *, in_metres: bool = False) -> Panel | None:
    """A depth image whose numbers are coloured, red far away."""
    panel = picture(name, f"{title}, 0 to {_MOST_DEPTH_M} m", topic)
    if panel:
        most = _MOST_DEPTH_M if in_metres else _MOST_DEPTH_M * _MM_PER_M
        colours = {"colorMode": "colormap", "colorMap": "turbo", "minValue": 0, "maxValue": most}
        panel.config["imageMode"].update(colours)
    return panel


def raw_messages(name: str, title: str, topic: str | None) -> Panel | None:
    """A topic's messages as a tree that can be unfolded."""
    if topic is None:
        return None
    shown = {"topicPath": topic, "diffEnabled": False, "diffMethod": "previous message", "diffTopicPath": ""}
    return Panel("RawMessages", name, {**shown, "showFullMessageForDiff": False, "expansion": "none", **titled(title)})


def table(name: str, title: str, path: str | None) -> Panel | None:
    """The items of a list in a message, a row each."""
    return Panel("Table", name, {"topicPath": path, **titled(title)}) if path else None


def words(name: str, title: str, topic: str | None) -> Panel | None:
    """A topic of log messages."""
    if topic is None:
        return None
    return Panel("RosOut", name, {"searchTerms": [], "minLogLevel": 1, "topicToRender": topic, **titled(title)})


ROWS: Final = "rows"
"""The field that lists a table's rows."""
_UNKNOWN: Final = "-"

_OBJECTS_SOURCE: Final = """\
// One row per detection, in words: what roadperc.Objects says in numbers and nested messages.
type Detected = {
  detection?: { label: string; score: number };
  kept: boolean;
  class_ratio?: number;
  distance_m?: number;
  distance_std_m?: number;
  closing_speed_mps?: number;
  time_to_impact_s?: number;
  beyond_range: boolean;
  status: number;
  track_id: string;
};
type Row = {
  class: string;
  status: string;
  filter: string;
  distance: string;
  closing: string;
  impact: string;
  score: string;
  track: string;
};
type Table = { rows: Row[] };

export const inputs = [INPUT];
export const output = OUTPUT;

const statuses: { [status: number]: string } = STATUSES;

function text(value: number | undefined, unit: string, digits: number): string {
  return value == undefined ? UNKNOWN : value.toFixed(digits) + unit;
}

function distance(seen: Detected): string {
  if (seen.distance_m == undefined) {
    return seen.beyond_range ? "beyond range" : UNKNOWN;
  }
  const deviation = seen.distance_std_m == undefined ? "" : " ± " + seen.distance_std_m.toFixed(1);
  return seen.distance_m.toFixed(1) + deviation + " m";
}

function filter(seen: Detected): string {
  return !seen.kept ? "dropped" : seen.class_ratio == undefined ? "unverified" : "kept";
}

export default function script(event: { message: { objects: Detected[] } }): Table {
  return {
    rows: event.message.objects.map((seen) => ({
      class: seen.detection?.label ?? UNKNOWN,
      status: statuses[seen.status] ?? UNKNOWN,
      filter: filter(seen),
      distance: distance(seen),
      closing: text(seen.closing_speed_mps, " m/s", 1),
      impact: text(seen.time_to_impact_s, " s", 1),
      score: text(seen.detection?.score, "", 2),
      track: seen.track_id || UNKNOWN,
    })),
  };
}
"""
_DETECTIONS_SOURCE: Final = """\
// One row per detection, without messages in messages.
type Detection = {
  label: string;
  score: number;
  id: string;
  box_px?: { x_min: number; y_min: number; x_max: number; y_max: number };
};
type Row = { class: string; score: string; columns: string; rows: string; id: string };
type Table = { rows: Row[] };

export const inputs = [INPUT];
export const output = OUTPUT;

function range(from: number | undefined, to: number | undefined): string {
  return from == undefined || to == undefined ? UNKNOWN : from.toFixed(0) + " to " + to.toFixed(0);
}

export default function script(event: { message: { detections: Detection[] } }): Table {
  return {
    rows: event.message.detections.map((seen) => ({
      class: seen.label,
      score: seen.score.toFixed(2),
      columns: range(seen.box_px?.x_min, seen.box_px?.x_max),
      rows: range(seen.box_px?.y_min, seen.box_px?.y_max),
      id: seen.id || UNKNOWN,
    })),
  };
}
"""


def objects_table(topic: str) -> Script:
    """Rows of a topic of ``roadperc.Objects``: class, status and filter in words, numbers with units."""
    statuses = {number: name.lower() for name, number in pb.Object.Status.items() if number}
    return _script("objects_table", topic, _OBJECTS_SOURCE.replace("STATUSES", json.dumps(statuses)))


def detections_table(topic: str) -> Script:
    """Rows of a topic of ``roadperc.Detections``."""
    return _script("detections_table", topic, _DETECTIONS_SOURCE)


def _script(name: str, topic: str, source: str) -> Script:
    output = f"/studio_script/{name}"
    texts = {"INPUT": topic, "OUTPUT": output, "UNKNOWN": _UNKNOWN}
    for placeholder, value in texts.items():
        source = source.replace(placeholder, json.dumps(value, ensure_ascii=False))
    return Script(name, output, source)
