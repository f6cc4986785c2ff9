"""A CARLA dump folder to a log."""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.progress import Progress

from roadperc_stream import __version__
from roadperc_stream.errors import DumpError
from roadperc_stream.log import LogWriter, Message, Metadata
from roadperc_stream.output.terminal import PipeConsole, print_lines
from roadperc_stream.schemas.record import CONVERSION_RECORD, PIXEL_ORIGIN_KEY
from roadperc_stream.system.files import require_free
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import print_line

from .carla_dump.messages import channels, messages
from .carla_dump.plan import ConvertOptions, Plan, make_plan
from .carla_dump.report import console, print_plan

_MISSING: Final = "counted as missing: {}"


def convert(arguments: argparse.Namespace) -> None:
    """Convert a dump as the arguments say; ``role`` holds pairs of a role and a path.

    Raises:
        RoadpercError: the dump cannot be converted, or the log not be written.
    """
    _convert(arguments.dump, arguments.out, _options(arguments), force=arguments.force, quiet=arguments.quiet)


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
    """Path of ``--role``: inside the dump, else as it stands."""
    found = next((path for path in (dump / name, Path(name)) if path.exists()), None)
    if found is None:
        raise DumpError(f"--role {role}={name}: no such file or folder, neither in {dump} nor here")
    return found


@dataclass
class _Progress:
    """Messages by role, and files that turned out to be no frames."""

    counts: Counter[str]
    unreadable: list[str]


def _convert(dump: Path, out: Path, options: ConvertOptions, *, force: bool, quiet: bool) -> None:
    require_free(out, force=force, suffix=".mcap")
    started = time.monotonic()
    plan = make_plan(dump, options)
    terminal = console(quiet=quiet)
    with optional_output():
        print_plan(terminal, plan)
    _warn((*plan.warnings, *map(_MISSING.format, plan.unreadable)))
    done = _write(plan, out, force=force, quiet=quiet)
    _warn(map(_MISSING.format, done.unreadable))
    megabytes, seconds = out.stat().st_size / 1e6, time.monotonic() - started
    said = f"{done.counts.total()} messages, {megabytes:.1f} MB, {seconds:.1f} s: {out}"
    print_lines(terminal, said, unbroken=True)


def _warn(texts: Iterable[str]) -> None:
    with optional_output(sys.stderr):
        for text in texts:
            print_line(f"warning: {text}", sys.stderr)


def _write(plan: Plan, out: Path, *, force: bool, quiet: bool) -> _Progress:
    done = _Progress(Counter(), [])
    with LogWriter(out) as log:
        for channel in channels(plan).values():
            log.register(channel)
        for role, message in _shown(messages(plan, done.unreadable), plan, quiet=quiet):
            log.write(message)
            done.counts[role] += 1
        lost = [role for role in plan.surveys if not done.counts[role]]
        if lost:
            raise DumpError(f"{lost[0]}: no file can be read; {(done.unreadable or ['none has a frame'])[0]}")
        log.describe(_description(plan))
        require_free(out, force=force, suffix=".mcap")  # another program may have written it meanwhile
    return done


def _shown(stream: Iterable[tuple[str, Message]], plan: Plan, *, quiet: bool) -> Iterator[tuple[str, Message]]:
    """The same messages, with a progress bar on a terminal."""
    terminal = PipeConsole(stderr=True)
    with Progress(console=terminal, disable=quiet or not terminal.is_terminal, transient=True) as bar:
        task = bar.add_task("writing", total=len(plan.stamps_ns))
        for role, message in stream:
            bar.update(task, completed=message.sequence)
            yield role, message


def _description(plan: Plan) -> Metadata:
    """How the log was made: nothing of the machine or the user."""
    encodings = {f"encoding.{role}": survey.encoding for role, survey in plan.surveys.items()}
    table = {"tag_table": plan.tag_table.name, "tag_table_known_by": plan.tag_table_source} if plan.tag_table else {}
    values = {"version": __version__, "frames": str(len(plan.frames)), "time": plan.timing, **encodings, **table}
    origin = {PIXEL_ORIGIN_KEY: plan.pixel_origin} if plan.pixel_origin else {}
    return Metadata(CONVERSION_RECORD, tuple(sorted({**values, **origin}.items())))
