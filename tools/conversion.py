"""Convert a recording to a log: a dump folder, images, or videos."""

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
from roadperc_stream.log import LogWriter, Message, Metadata, is_log
from roadperc_stream.output.terminal import PipeConsole, print_lines
from roadperc_stream.schemas.record import CONVERSION_RECORD, IMAGES_RECORD
from roadperc_stream.system.files import require_free
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import print_line

from .dataset_recording import recording_of_dataset
from .layouts.dataset import ConvertOptions
from .layouts.dump_folder import frame_count
from .layouts.known import KNOWN
from .recording import COLUMNS, Recording
from .video_log import recording_of_log
from .video_recording import recording_of_videos, videos_in

_PIPED_WIDTH: Final = 140
"""Columns of the output if it is not a terminal."""


def recording_of(path: Path, options: ConvertOptions) -> Recording:
    """Return the recording at a path; this is where the kind of an input is decided.

    Raises:
        RoadpercError: the recording cannot be converted.
    """
    try:
        if path.is_file():
            options.refuse(path, ["--layout", "--sequence"], "is an option for folders")
        if options.layout is None and is_log(path):
            options.require_only(path, ())
            return recording_of_log(path)
        if path.is_file():
            return recording_of_videos(path, [path], options)
        name = options.layout or next(name for name, layout in KNOWN.items() if layout.fits(path))
        is_dump = name == "dump" and options.layout is None and path.is_dir()
        videos = videos_in(path) if is_dump else []
        if len(videos) > (frame_count(path) if videos else 0):
            return recording_of_videos(path, videos, options)
        return recording_of_dataset(KNOWN[name], KNOWN[name].request(path, options))
    except OSError as error:
        raise DumpError(f"{path}: {error.strerror or error}") from error


def convert(path: Path, out: Path, options: ConvertOptions, *, force: bool = False, quiet: bool = False) -> None:
    """Convert a recording to a log, and print what was read from where.

    Raises:
        RoadpercError: the recording cannot be converted, or the log cannot be written.
    """
    require_free(out, force=force, suffix=".mcap")
    started = time.monotonic()
    recording = recording_of(path, options)
    terminal = PipeConsole(markup=False, highlight=False, emoji=False, quiet=quiet)
    if not terminal.is_terminal:
        terminal.width = _PIPED_WIDTH
    with optional_output():
        _print_facts(terminal, recording)
    count = write(recording, out, force=force, quiet=quiet)
    megabytes, seconds = out.stat().st_size / 1e6, time.monotonic() - started
    print_lines(terminal, f"{count} messages, {megabytes:.1f} MB, {seconds:.1f} s: {out}", unbroken=True)


def _warn(texts: Iterable[str]) -> None:
    with optional_output(sys.stderr):
        for text in texts:
            print_line(f"warning: {text}", sys.stderr)


def write(recording: Recording, out: Path, *, force: bool, quiet: bool) -> int:
    """Write the log, warn of what is lost, and return the number of messages.

    Raises:
        RoadpercError: a part of the recording cannot be read, or the log cannot be written.
    """
    _warn(recording.warnings)
    warnings: list[str] = []
    counts: Counter[str] = Counter()
    with LogWriter(out) as log:
        for channel in recording.channels.values():
            log.register(channel)
        for role, message in _shown(recording.messages(warnings), recording, quiet=quiet):
            log.write(message)
            counts[role] += 1
        lost = [role for role in recording.required if not counts[role]]
        if lost:
            raise DumpError(f"{lost[0]}: no file can be read; {(warnings or ['no file belongs to a frame'])[0]}")
        values = {"version": __version__, "frames": str(counts["image"]), **recording.metadata}
        log.describe(Metadata(CONVERSION_RECORD, tuple(sorted(values.items()))))
        if recording.images:
            log.describe(Metadata(IMAGES_RECORD, tuple(sorted(recording.images.items()))))
        require_free(out, force=force, suffix=".mcap")  # another program may have written it in the meantime
    _warn(warnings)
    return counts.total()


def _shown(
    stream: Iterable[tuple[str, Message]], recording: Recording, *, quiet: bool
) -> Iterator[tuple[str, Message]]:
    """Yield the messages, with a progress bar on a terminal."""
    terminal = PipeConsole(stderr=True)
    with Progress(console=terminal, disable=quiet or not terminal.is_terminal, transient=True) as bar:
        task = bar.add_task("writing", total=recording.frames or None)
        for role, message in stream:
            bar.advance(task, role == recording.required[0])
            yield role, message


def _print_facts(out: Console, recording: Recording) -> None:
    """Print roles, counts, sizes, encodings, time, tag table, cameras, mountings and notes."""
    table = Table(box=None, pad_edge=True, header_style="bold")
    for name in COLUMNS:
        table.add_column(name, justify="right" if name in ("frames", "missing") else "left", no_wrap=name != "encoding")
    for row in recording.sensors:
        table.add_row(*row)
    width = max(len(name) for name, _ in recording.facts)
    lines = (f" {name:<{width}}  {text}" for name, text in recording.facts)
    notes = (f" note: {note}" for note in recording.notes)
    print_lines(out, recording.title, table, *lines, *notes, unbroken=True)
