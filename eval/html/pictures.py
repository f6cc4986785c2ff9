"""Pictures of frames with the chain's results: of the worst frames, and at even distances in time."""

import base64
import math
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final, TypeVar

import polars as pl

from roadperc_stream.errors import RoadpercError
from roadperc_stream.formats.images import encode_jpeg
from roadperc_stream.input.stream import Problems
from roadperc_stream.log import LogSummary, summarise
from roadperc_stream.model import Image
from roadperc_stream.output.drawing.overlay import PerceivedFrame, draw_results
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT
from roadperc_stream.view.result_frames import read_frame, read_frames

from ..frame_commands import view_command
from ..report.summaries import WorstFrame
from ..runs import Run, collect
from ..scan import SEGMENT, rows_of, since_start_s

WORST: Final = 10
"""Worst frames on the page, over all runs."""
OVER_TIME: Final = 48
"""Pictures at even distances in time, over all runs."""
WIDTH_PX: Final = 480
JPEG_QUALITY: Final = 70
T = TypeVar("T")
Key = tuple[str, int]
"""A run's name and a frame's number."""
Command = Callable[[Run, int], str]
"""The command that shows a frame of a run."""


@dataclass(frozen=True)
class Picture:
    """A frame of a run: ``image`` is a data URI or empty, ``command`` shows the frame."""

    anchor: str
    frame: WorstFrame
    image: str
    command: str


@dataclass(frozen=True)
class Gallery:
    """The pictures by run and frame, in the order of runs and frames, and notes on missing pictures."""

    pictures: dict[Key, Picture]
    notes: list[str]


def gallery(wanted: Iterable[WorstFrame], runs: Sequence[Run], command: Command = view_command) -> Gallery:
    """Pictures of the wanted frames, and of frames at even distances in time where the log has an image."""
    frames = {(frame.run, frame.frame): frame for frame in wanted}
    asked = list(frames)
    for run in runs:
        each = max(run.frames * len(runs) // OVER_TIME, 1)
        for frame in frames_of(run, pl.int_range(pl.len()) % each == 0):
            frames.setdefault((frame.run, frame.frame), frame)
    by_name = {run.name: (place, run) for place, run in enumerate(runs)}
    images, notes = _images(list(frames.values()), asked, runs)
    pictures = {
        key: Picture(f"frame-{place}", frames[key], images.get(key, ""), command(by_name[key[0]][1], key[1]))
        for place, key in enumerate(sorted(frames, key=lambda key: (by_name[key[0]][0], key[1])), 1)
        if key in images or key in asked
    }
    return Gallery(pictures, notes)


def frames_of(run: Run, wanted: pl.Expr) -> list[WorstFrame]:
    """The frames of a run for which an expression holds, without values."""
    rows = rows_of(run).select("frame", "stamp_ns", SEGMENT).with_columns(since_start_s())
    found = collect(rows.filter(wanted), run.source_name).iter_rows(named=True)
    return [WorstFrame(run.name, run.config_digest, value=math.nan, **row) for row in found]


def data_uri(image_bgr: Image) -> str:
    """A JPEG as a data URI."""
    return "data:image/jpeg;base64," + base64.b64encode(encode_jpeg(image_bgr, JPEG_QUALITY)).decode()


def _images(
    frames: Sequence[WorstFrame], asked: Container[Key], runs: Sequence[Run]
) -> tuple[dict[Key, str], list[str]]:
    """Pictures of the frames whose logs exist, and a line for each log that lacks pictures of the ``asked`` frames."""
    images: dict[Key, str] = {}
    notes: list[str] = []
    for run in runs:
        for table in run.tables:
            end = math.inf if table.end_frame is None else table.end_frame
            wanted = [frame for frame in frames if frame.run == run.name and table.first_frame <= frame.frame < end]
            if not wanted and len(run.tables) > 1:
                continue
            found, why = drawn_from_log(wanted, asked, table, lambda seen: data_uri(draw_results(seen, WIDTH_PX)))
            images |= found
            notes += [f"{run.name}: {why}"] if why else []
    return images, notes


def log_of(table: Run) -> Path | None:
    """The log that a table names, or a log beside the table if the named one does not exist; None without both.

    A run's files are often moved together to another machine.
    """
    named = Path(table.log) if table.log else None
    moved = (named is None or not named.is_file()) and table.beside(".mcap").is_file()
    return table.beside(".mcap") if moved else named


def drawn_from_log(
    frames: Sequence[WorstFrame], asked: Container[Key], table: Run, draw: Callable[[PerceivedFrame], T]
) -> tuple[dict[Key, T], str]:
    """What ``draw`` makes of a table's frames from their log, and a note on ``asked`` frames without a picture."""
    log = log_of(table)
    if log is None or not log.is_file():
        name = log.name if log else "its log"
        return {}, f"{name} is not where the table says; no pictures of its frames."
    images: dict[Key, T] = {}
    problems = Problems()
    try:
        summary = summarise(log)
        stored = [sha256(item.data).hexdigest() for item in summary.attachments if item.name == CONFIG_ATTACHMENT]
        if table.config_digest and any(digest != table.config_digest for digest in stored):
            again = f"{log.name} was replayed again with another configuration"
            return {}, f"{again}; no pictures of this run."
        for frame, seen in _seen(summary, frames, problems):
            images[frame.run, frame.frame] = draw(seen)
    except RoadpercError as error:
        return images, f"no more pictures: {str(error).replace(str(log), log.name)}"
    lacking = sum((frame.run, frame.frame) in asked and (frame.run, frame.frame) not in images for frame in frames)
    notes = [f"{log.name} holds no camera image of {lacking} of these frames."] if lacking else []
    notes += [f"not drawn, because unreadable: {'; '.join(problems.first.values())}."] if problems.first else []
    return images, " ".join(notes)


def _seen(
    log: LogSummary, frames: Sequence[WorstFrame], problems: Problems
) -> Iterator[tuple[WorstFrame, PerceivedFrame]]:
    """The frames with a camera image in the log, each with its results."""
    if any(frame.segment for frame in frames):  # stamps repeat in later segments, so the log is read from the start
        wanted = {frame.frame: frame for frame in frames}
        for row, seen in read_frames(log, problems):
            if seen and row.frame in wanted:
                yield wanted.pop(row.frame), seen
            if not wanted:
                return
    else:
        for frame in frames:
            if seen := read_frame(log.path, frame.stamp_ns, problems):
                yield frame, seen
