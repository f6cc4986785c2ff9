"""The worst frames of each metric, with a picture of each that shows the chain's results."""

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

from ..quantities import Quantity, rounded
from ..runs import Run
from ..sections import ranked_by
from ..summary import Summary, WorstFrame

WORST: Final = 10
"""Frames shown for each metric, over all configurations."""
WIDTH_PX: Final = 400
JPEG_QUALITY: Final = 75
Key = tuple[str, int]
"""A run's name and a frame's number."""
Ranking = tuple[str, str, list[tuple[str, WorstFrame, str]]]
"""A metric, the name of the configuration if there are several, and anchor, frame and value of each frame."""


@dataclass(frozen=True)
class Picture:
    """One of the worst frames: ``image`` is a data URI or empty, ``places`` are its metrics, values and ranks."""

    anchor: str
    frame: WorstFrame
    image: str
    places: list[tuple[str, str, int]]


@dataclass(frozen=True)
class Gallery:
    """The rankings, one picture per frame in the order of runs and frames, and notes on missing pictures."""

    rankings: list[Ranking]
    pictures: list[Picture]
    notes: list[str]


def gallery(groups: Sequence[Summary], runs: Sequence[Run]) -> Gallery:
    """The worst frames by each truth metric, or without truth by the suspect quantities.

    Args:
        groups: summary over the runs of each configuration, with its worst frames.
        runs: the runs of all groups, in the order in which their frames are shown.
    """
    ranked = [
        (quantity, group.name if len(groups) > 1 else "", group.worst.get(quantity.column, ()))
        for quantity in ranked_by(groups)
        for group in groups
    ]
    worst = {(frame.run, frame.frame): frame for _, _, frames in ranked for frame in frames}
    at = {run.name: number for number, run in enumerate(runs)}
    order = sorted(worst, key=lambda key: (at[key[0]], key[1]))
    anchors = {key: f"frame-{number}" for number, key in enumerate(order, 1)}
    images, notes = _images([worst[key] for key in order], runs)
    pictures = {key: Picture(anchors[key], worst[key], images.get(key, ""), []) for key in order}
    rankings: list[Ranking] = []
    for quantity, group, frames in ranked:
        values = [shown(frame.value, quantity) for frame in frames]
        keys = [(frame.run, frame.frame) for frame in frames]
        for rank, (key, value) in enumerate(zip(keys, values, strict=True), 1):
            pictures[key].places.append((quantity.label, value, rank))
        if frames:
            named = list(zip(map(anchors.__getitem__, keys), frames, values, strict=True))
            rankings.append((quantity.label, group, named))
    return Gallery(rankings, list(pictures.values()), notes)


def shown(value: float, quantity: Quantity) -> str:
    """A value with its unit."""
    unit = "" if quantity.unit in UNITLESS else f" {quantity.unit}"
    return rounded(value, quantity) + unit


def data_uri(image_bgr: Image) -> str:
    """A JPEG as a data URI."""
    _, encoded = cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(encoded.tobytes()).decode()


def _images(frames: Sequence[WorstFrame], runs: Sequence[Run]) -> tuple[dict[Key, str], list[str]]:
    """Pictures of the frames whose logs exist, and a line for each log without pictures."""
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
    """The log that a table names, or a log beside the table if the named one does not exist; None without both.

    A run's files are often moved together to another machine.
    """
    named = Path(table.log) if table.log else None
    moved = (named is None or not named.is_file()) and table.beside(".mcap").is_file()
    return table.beside(".mcap") if moved else named


def _of_log(frames: Sequence[WorstFrame], table: Run) -> tuple[dict[Key, str], str]:
    """Pictures of a table's frames, and a note on frames without a picture."""
    log = log_of(table)
    if log is None or not log.is_file():
        name = log.name if log else "its log"
        return {}, f"{name} is not where the table says; no pictures of its frames."
    images: dict[Key, str] = {}
    problems = Problems()
    try:
        summary = summarise(log)
        stored = [sha256(item.data).hexdigest() for item in summary.attachments if item.name == CONFIG_ATTACHMENT]
        if table.config_digest and any(digest != table.config_digest for digest in stored):
            again = f"{log.name} was replayed again with another configuration"
            return {}, f"{again}; no pictures of this run."
        for frame, seen in _seen(summary, frames, problems):
            images[frame.run, frame.frame] = data_uri(draw_results(seen, WIDTH_PX))
    except RoadpercError as error:
        return images, f"no more pictures: {str(error).replace(str(log), log.name)}"
    lacking = len(frames) - len(images)
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
