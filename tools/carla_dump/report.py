"""What was found in a dump, as a table for the terminal."""

from rich.console import Console
from rich.table import Table

from roadperc_stream.geometry import Camera
from roadperc_stream.output.terminal import PipeConsole, print_lines
from roadperc_stream.system.text import shown

from .camera_rig import LIDAR
from .plan import Plan

_PIPED_WIDTH = 140


def console(*, quiet: bool) -> Console:
    """Console on stdout that prints text as it is; wide where it is not a terminal."""
    plain = PipeConsole(markup=False, highlight=False, emoji=False, quiet=quiet)
    if not plain.is_terminal:
        plain.width = _PIPED_WIDTH
    return plain


def print_plan(out: Console, plan: Plan) -> None:
    """Roles, counts, sizes, encodings, time, tag table, cameras, mountings and notes."""
    facts = _facts(plan)
    width = max(len(name) for name, _ in facts)
    said = (f" {name:<{width}}  {text}" for name, text in facts)
    notes = (f" note: {note}" for note in plan.notes)
    title = f"{plan.layout.dump}: {len(plan.frames)} frames"
    print_lines(out, title, _sensor_table(plan), *said, *notes, unbroken=True)


def _sensor_table(plan: Plan) -> Table:
    table = Table(box=None, pad_edge=True, header_style="bold")
    for name, side in (("role", "left"), ("from", "left"), ("frames", "right"), ("missing", "right")):
        table.add_column(name, justify="right" if side == "right" else "left", no_wrap=True)
    table.add_column("size", no_wrap=True)
    table.add_column("encoding")
    for role, survey in plan.surveys.items():
        camera, count = plan.rig.camera_of(role), sum(number in plan.stamps_ns for number in survey.sensor.files)
        size = "" if role == LIDAR else f"{camera.width}x{camera.height}"
        table.add_row(role, shown(survey.sensor.source), str(count), str(plan.missing[role]), size, survey.encoding)
    if plan.detections:
        missing = str(sum(number not in plan.detections for number in plan.frames))
        boxes = f"{sum(map(len, plan.detections.values()))} boxes"
        table.add_row("detections", shown(plan.detections_source), str(len(plan.detections)), missing, "", boxes)
    return table


def _facts(plan: Plan) -> list[tuple[str, str]]:
    facts = [("time", plan.timing)]
    if plan.tag_table is not None:
        facts.append(("tags", f"{plan.tag_table.name} ({plan.tag_table_source})"))
    facts += [(role.replace("_", " "), _camera(camera)) for role, camera in plan.rig.cameras.items()]
    facts += [("pixel origin", plan.pixel_origin)] if plan.pixel_origin else []
    facts.append(("mounting", _mounting(plan)))
    truth = {
        "poses": plan.poses,
        "surface": plan.truth.surfaces,
        "lanes": plan.truth.lanes,
        "objects": plan.truth.objects,
    }
    counts = [f"{name} {len(entries)}" for name, entries in truth.items() if entries]
    return facts + ([("truth", ", ".join(counts))] if counts else [])


def _camera(camera: Camera) -> str:
    pair = f", baseline {camera.baseline_m:g} m" if camera.baseline_m else ""
    where = f"cx {camera.cx:g} cy {camera.cy:g} (pixel centres from 0)"
    return f"{camera.frame_id}: fx {camera.fx:g} fy {camera.fy:g} {where}{pair}"


def _mounting(plan: Plan) -> str:
    edges = [
        f"{edge.parent} -> {edge.child} at {', '.join(f'{value:g}' for value in edge.parent_T_child[:3, 3].round(4))} m"
        for edge in plan.rig.transforms
    ]
    return "; ".join(edges) or "not known"
