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

export const inputs = ["/perception/objects"];
export const output = "/studio_script/objects_table";

const statuses: { [status: number]: string } = {"1": "measured", "2": "tracked", "3": "lost"};

function text(value: number | undefined, unit: string, digits: number): string {
  return value == undefined ? "-" : value.toFixed(digits) + unit;
}

function distance(seen: Detected): string {
  if (seen.distance_m == undefined) {
    return seen.beyond_range ? "beyond range" : "-";
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
      class: seen.detection?.label ?? "-",
      status: statuses[seen.status] ?? "-",
      filter: filter(seen),
      distance: distance(seen),
      closing: text(seen.closing_speed_mps, " m/s", 1),
      impact: text(seen.time_to_impact_s, " s", 1),
      score: text(seen.detection?.score, "", 2),
      track: seen.track_id || "-",
    })),
  };
}
