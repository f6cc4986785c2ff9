"""Convert a CARLA dump folder to a log."""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from roadperc_stream import __version__
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera
from roadperc_stream.log import LogWriter, Message, Metadata
from roadperc_stream.output.terminal import PipeConsole, print_lines
from roadperc_stream.schemas.record import CONVERSION_RECORD, PIXEL_ORIGIN_KEY
from roadperc_stream.system.files import require_free
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import print_line, shown

from .carla_dump.camera_rig import LIDAR
from .carla_dump.messages import channels, messages
from .carla_dump.plan import ConvertOptions, Plan, make_plan

_MISSING: Final = "counted as missing: {}"
_PIPED_WIDTH: Final = 140
"""Columns of the output if it is not a terminal."""


def convert(arguments: argparse.Namespace) -> None:
    """Convert a dump; ``arguments.role`` holds pairs of a role and a path.

    Raises:
        RoadpercError: the dump cannot be converted, or the log cannot be written.
    """
    out = arguments.out
    require_free(out, force=arguments.force, suffix=".mcap")
    started = time.monotonic()
    plan = make_plan(arguments.dump, _options(arguments))
    terminal = PipeConsole(markup=False, highlight=False, emoji=False, quiet=arguments.quiet)
    if not terminal.is_terminal:
        terminal.width = _PIPED_WIDTH
    with optional_output():
        _print_plan(terminal, plan)
    _warn((*plan.warnings, *map(_MISSING.format, plan.unreadable)))
    unreadable: list[str] = []
    count = _write(plan, out, unreadable, force=arguments.force, quiet=arguments.quiet)
    _warn(map(_MISSING.format, unreadable))
    megabytes, seconds = out.stat().st_size / 1e6, time.monotonic() - started
    print_lines(terminal, f"{count} messages, {megabytes:.1f} MB, {seconds:.1f} s: {out}", unbroken=True)


def _options(arguments: argparse.Namespace) -> ConvertOptions:
    return ConvertOptions(
        roles={role: _role_path(arguments.dump, role, name) for role, name in arguments.role},
        carla=arguments.carla,
        fov_deg=arguments.fov,
        rate_hz=arguments.rate,
        depth_as_float=arguments.depth == "float",
        allow_lossy_tags=arguments.allow_lossy_tags,
        grey_depth=arguments.grey_depth,
    )


def _role_path(dump: Path, role: str, name: str) -> Path:
    """Return the path of ``--role``: inside the dump, else relative to the working directory."""
    found = next((path for path in (dump / name, Path(name)) if path.exists()), None)
    if found is None:
        raise DumpError(f"--role {role}={name}: no such file or folder in {dump} or in the working directory")
    return found


def _warn(texts: Iterable[str]) -> None:
    with optional_output(sys.stderr):
        for text in texts:
            print_line(f"warning: {text}", sys.stderr)


def _write(plan: Plan, out: Path, unreadable: list[str], *, force: bool, quiet: bool) -> int:
    """Write the log and return the number of messages; append errors of unreadable files to ``unreadable``."""
    counts: Counter[str] = Counter()
    with LogWriter(out) as log:
        for channel in channels(plan).values():
            log.register(channel)
        for role, message in _shown(messages(plan, unreadable), plan, quiet=quiet):
            log.write(message)
            counts[role] += 1
        lost = [role for role in plan.surveys if not counts[role]]
        if lost:
            raise DumpError(f"{lost[0]}: no file can be read; {(unreadable or ['no file belongs to a frame'])[0]}")
        log.describe(_description(plan))
        require_free(out, force=force, suffix=".mcap")  # another program may have written it in the meantime
    return counts.total()


def _shown(stream: Iterable[tuple[str, Message]], plan: Plan, *, quiet: bool) -> Iterator[tuple[str, Message]]:
    """Yield the messages, with a progress bar on a terminal."""
    terminal = PipeConsole(stderr=True)
    with Progress(console=terminal, disable=quiet or not terminal.is_terminal, transient=True) as bar:
        task = bar.add_task("writing", total=len(plan.stamps_ns))
        for role, message in stream:
            bar.update(task, completed=message.sequence)
            yield role, message


def _description(plan: Plan) -> Metadata:
    """Return how the log was made, without data of the machine or the user."""
    encodings = {f"encoding.{role}": survey.encoding for role, survey in plan.surveys.items()}
    table = {"tag_table": plan.tag_table.name, "tag_table_known_by": plan.tag_table_source} if plan.tag_table else {}
    values = {"version": __version__, "frames": str(len(plan.frames)), "time": plan.timing, **encodings, **table}
    origin = {PIXEL_ORIGIN_KEY: plan.pixel_origin} if plan.pixel_origin else {}
    return Metadata(CONVERSION_RECORD, tuple(sorted({**values, **origin}.items())))


def _print_plan(out: Console, plan: Plan) -> None:
    """Print roles, counts, sizes, encodings, time, tag table, cameras, mountings and notes."""
    facts = _facts(plan)
    width = max(len(name) for name, _ in facts)
    lines = (f" {name:<{width}}  {text}" for name, text in facts)
    notes = (f" note: {note}" for note in plan.notes)
    title = f"{plan.layout.dump}: {len(plan.frames)} frames"
    print_lines(out, title, _sensor_table(plan), *lines, *notes, unbroken=True)


def _sensor_table(plan: Plan) -> Table:
    table = Table(box=None, pad_edge=True, header_style="bold")
    for name in ("role", "from", "frames", "missing", "size", "encoding"):
        table.add_column(name, justify="right" if name in ("frames", "missing") else "left", no_wrap=name != "encoding")
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
    truth = {"surface": plan.truth.surfaces, "lanes": plan.truth.lanes, "objects": plan.truth.objects}
    counts = [f"{name} {len(entries)}" for name, entries in ({"poses": plan.poses} | truth).items() if entries]
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
    return "; ".join(edges) or "unknown"
