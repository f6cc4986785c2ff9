"""The worst frames of each metric: which they are, and a picture of each with what the chain saw drawn into it."""

import base64
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final

import cv2

from roadperc_stream.errors import RoadpercError
from roadperc_stream.input.stream import Problems
from roadperc_stream.log import LogSummary, summarise
from roadperc_stream.model import Image
from roadperc_stream.output.drawing.overlay import PerceivedFrame, draw_results
from roadperc_stream.schemas.columns import UNITLESS
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT
from roadperc_stream.view.result_frames import read_frame, read_frames

from ..names import rounded
from ..quantities import Quantity
from ..runs import Run
from ..sections import ranked_by
from ..summary import Summary, WorstFrame

WORST: Final = 10
"""Frames shown of each metric, of all configurations together."""
WIDTH_PX: Final = 400
JPEG_QUALITY: Final = 75
Key = tuple[str, int]
"""A run's name and a frame's number."""
Ranked = tuple[Quantity, str, tuple[WorstFrame, ...]]
"""A metric, the name of a group of runs, and its worst frames."""


@dataclass(frozen=True)
class Place:
    """A frame's place among the worst of a metric."""

    metric: str
    value: str
    rank: int


@dataclass(frozen=True)
class Picture:
    """One of the worst frames: ``image`` is a data URI, empty where there is none, and ``places`` why it is here."""

    anchor: str
    run: str
    frame: int
    since_start_s: float
    places: tuple[Place, ...]
    image: str


@dataclass(frozen=True)
class Ranking:
    """The worst frames of a metric: (anchor, run, frame, value), the worst first.

    ``group`` names whose they are, where there are several configurations.
    """

    metric: str
    group: str
    frames: tuple[tuple[str, str, int, str], ...]


@dataclass(frozen=True)
class Gallery:
    """The rankings, each frame's picture once, in the order of runs and frames, and why pictures are missing."""

    rankings: tuple[Ranking, ...]
    pictures: tuple[Picture, ...]
    notes: tuple[str, ...]


def gallery(groups: Sequence[Summary], runs: Sequence[Run]) -> Gallery:
    """The worst frames, by each truth metric, or, without any truth, by signs of trouble.

    Args:
        groups: summary over the runs of each configuration, with its worst frames: each has its own.
        runs: those of all groups, in the order in which their frames are shown.
    """
    ranked = [
        (quantity, group.name, frames)
        for quantity in ranked_by(groups)
        for group in groups
        if (frames := group.worst.get(quantity.column, ()))
    ]
    worst = {(f.run, f.frame): f for _, _, frames in ranked for f in frames}
    at = {run.name: number for number, run in enumerate(runs)}
    order = sorted(worst.values(), key=lambda f: (at[f.run], f.frame))
    anchors = {(f.run, f.frame): f"frame-{k}" for k, f in enumerate(order, 1)}
    places = _places(ranked)
    images, notes = _images(order, runs)
    pictures = tuple(
        Picture(anchors[key], f.run, f.frame, f.since_start_s, tuple(places[key]), images.get(key, ""))
        for f in order
        for key in [(f.run, f.frame)]
    )
    rankings = tuple(
        Ranking(
            q.label,
            group if len(groups) > 1 else "",
            tuple((anchors[f.run, f.frame], f.run, f.frame, shown(f.value, q)) for f in frames),
        )
        for q, group, frames in ranked
    )
    return Gallery(rankings, pictures, tuple(notes))


def shown(value: float, quantity: Quantity) -> str:
    """A value with its unit."""
    unit = "" if quantity.unit in UNITLESS else f" {quantity.unit}"
    return rounded(value, quantity) + unit


def data_uri(image_bgr: Image) -> str:
    """A picture as a page carries it in itself: a JPEG."""
    _, encoded = cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(encoded.tobytes()).decode()


def _places(ranked: Sequence[Ranked]) -> dict[Key, list[Place]]:
    places: dict[Key, list[Place]] = {}
    for quantity, _, frames in ranked:
        for rank, frame in enumerate(frames, 1):
            place = Place(quantity.label, shown(frame.value, quantity), rank)
            places.setdefault((frame.run, frame.frame), []).append(place)
    return places


def _images(frames: Sequence[WorstFrame], runs: Sequence[Run]) -> tuple[dict[Key, str], list[str]]:
    """Pictures of the frames whose log is there, and a line on each log that has to go without."""
    images: dict[Key, str] = {}
    notes: list[str] = []
    for run in runs:
        for table in run.tables:
            end = math.inf if table.end_frame is None else table.end_frame
            wanted = [frame for frame in frames if frame.run == run.name and table.first_frame <= frame.frame < end]
            found, why = _of_log(wanted, table) if wanted or len(run.tables) == 1 else ({}, "")
            images |= found
            notes += [f"{run.name}: {why}"] if why else []
    return images, notes


def log_of(table: Run) -> Path | None:
    """The log with results that a table names, or the one next to it where that is gone; None where it names none.

    A run's files are often moved together, from the machine that replayed to the one that reports.
    """
    named = Path(table.log) if table.log else None
    moved = (named is None or not named.is_file()) and table.beside(".mcap").is_file()
    return table.beside(".mcap") if moved else named


def _of_log(frames: Sequence[WorstFrame], table: Run) -> tuple[dict[Key, str], str]:
    """Pictures of frames of a table, and what there is to say of those that have none."""
    log = log_of(table)
    if log is None or not log.is_file():
        name = log.name if log else "its log"
        return {}, f"{name} is not where the table says, so there are no pictures of its frames."
    images: dict[Key, str] = {}
    problems = Problems()
    try:
        summary = summarise(log)
        stored = [sha256(item.data).hexdigest() for item in summary.attachments if item.name == CONFIG_ATTACHMENT]
        if table.config_digest and any(digest != table.config_digest for digest in stored):
            again = f"{log.name} was replayed again with another configuration"
            return {}, f"{again}, so it has no pictures of this run."
        for frame, seen in _seen(summary, frames, problems):
            images[frame.run, frame.frame] = data_uri(draw_results(seen, WIDTH_PX))
    except RoadpercError as error:
        return images, f"no more pictures: {str(error).replace(str(log), log.name)}"
    lacking = len(frames) - len(images)
    notes = [f"{log.name} holds no camera image of {lacking} of these frames."] if lacking else []
    notes += [f"What could not be read is not drawn: {'; '.join(problems.first.values())}."] if problems.first else []
    return images, " ".join(notes)


def _seen(
    log: LogSummary, frames: Sequence[WorstFrame], problems: Problems
) -> Iterator[tuple[WorstFrame, PerceivedFrame]]:
    """The frames of which the log has a camera image, each with what the log has of it."""
    if any(frame.segment for frame in frames):  # stamps come again there, so the log is read from the beginning
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
