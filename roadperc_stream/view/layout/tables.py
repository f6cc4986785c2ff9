"""Tables of objects and detections, made by scripts that run in the viewer."""

import json
from typing import Final

from roadperc_stream.schemas import roadperc_pb2 as pb
from roadperc_stream.view.layout.panels import Config, Node, panel

_OBJECTS_SOURCE: Final = """\
// One row per detection: the content of roadperc.Objects as text.
type Detected = {
  detection?: { label: string; score: number };
  kept: boolean;
  class_ratio?: number;
  distance_m?: number;
  distance_std_m?: number;
  distance_source?: string;
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
  return seen.distance_m.toFixed(1) + deviation + (seen.distance_source ? " m " + seen.distance_source : " m");
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
// One row per detection, without nested messages.
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


def objects_table(topic: str) -> tuple[Node, Config]:
    """The table of a ``roadperc.Objects`` topic: class, status and filter as text, numbers with units.

    Returns:
        The panel, and the script as the viewers store it.
    """
    statuses = {number: name.lower() for name, number in pb.Object.Status.items() if number}
    return _table("objects_table", "Objects", topic, _OBJECTS_SOURCE.replace("STATUSES", json.dumps(statuses)))


def detections_table(topic: str) -> tuple[Node, Config]:
    """The table of a ``roadperc.Detections`` topic, like ``objects_table``."""
    return _table("detections_table", "Detections", topic, _DETECTIONS_SOURCE)


def _table(name: str, title: str, topic: str, source: str) -> tuple[Node, Config]:
    output = f"/studio_script/{name}"
    for placeholder, value in {"INPUT": topic, "OUTPUT": output, "UNKNOWN": "-"}.items():
        source = source.replace(placeholder, json.dumps(value, ensure_ascii=False))
    return panel("Table", name, title, topicPath=f"{output}.rows"), {"name": name, "sourceCode": source}
