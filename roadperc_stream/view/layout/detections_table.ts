// One row per detection, without nested messages.
type Detection = {
  label: string;
  score: number;
  id: string;
  box_px?: { x_min: number; y_min: number; x_max: number; y_max: number };
};
type Row = { class: string; score: string; columns: string; rows: string; id: string };
type Table = { rows: Row[] };

export const inputs = ["/camera/front/detections"];
export const output = "/studio_script/detections_table";

function range(from: number | undefined, to: number | undefined): string {
  return from == undefined || to == undefined ? "-" : from.toFixed(0) + " to " + to.toFixed(0);
}

export default function script(event: { message: { detections: Detection[] } }): Table {
  return {
    rows: event.message.detections.map((seen) => ({
      class: seen.label,
      score: seen.score.toFixed(2),
      columns: range(seen.box_px?.x_min, seen.box_px?.x_max),
      rows: range(seen.box_px?.y_min, seen.box_px?.y_max),
      id: seen.id || "-",
    })),
  };
}
