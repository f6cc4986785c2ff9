"""The worst frames of each metric: which they are, and a picture of each with what the chain saw drawn into it."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2

from roadperc_stream.core.datatypes import Image
from roadperc_stream.errors import RoadpercError
from roadperc_stream.input.problems import Problems
from roadperc_stream.log import summarise
from roadperc_stream.output.drawing.frame import PerceivedFrame, draw_results
from roadperc_stream.schemas.columns import UNITLESS
from roadperc_stream.view.result_frames import read_frame, read_frames

from ..grid import rounded
from ..quantities import Quantity
from ..sections import ranked_by
from ..summary import Summary, WorstFrame
from .sources import Sources

WORST: Final = 10
"""Frames shown of each metric, of all configurations together."""
WIDTH_PX: Final = 400
JPEG_QUALITY: Final = 75
Key = tuple[str, int]
"""A run's name and a frame's number."""
Seen = tuple[WorstFrame, PerceivedFrame]
"""One of the worst frames, and what the log has of it."""
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


def gallery(groups: Sequence[Summary], sources: Mapping[str, Sequence[Sources]]) -> Gallery:
    """The worst frames, by each truth metric, or, without any truth, by signs of trouble.

    Args:
        groups: summary over the runs of each configuration, with its worst frames: each has its own.
        sources: the files of each table of each run, by the run's name.
    """
    ranked = _ranked(groups)
    worst = {(f.run, f.frame): f for _, _, frames in ranked for f in frames}
    order = sorted(worst.values(), key=lambda f: (list(sources).index(f.run), f.frame))
    anchors = {(f.run, f.frame): f"frame-{k}" for k, f in enumerate(order, 1)}
    places = _places(ranked)
    images, notes = _images(order, sources)
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


def _ranked(groups: Sequence[Summary]) -> list[Ranked]:
    return [
        (quantity, group.name, frames)
        for quantity in ranked_by(groups)
        for group in groups
        if (frames := group.worst.get(quantity.column, ()))
    ]


def _places(ranked: Sequence[Ranked]) -> dict[Key, list[Place]]:
    places: dict[Key, list[Place]] = {}
    for quantity, _, frames in ranked:
        for rank, frame in enumerate(frames, 1):
            place = Place(quantity.label, shown(frame.value, quantity), rank)
            places.setdefault((frame.run, frame.frame), []).append(place)
    return places


def _images(frames: Sequence[WorstFrame], sources: Mapping[str, Sequence[Sources]]) -> tuple[dict[Key, str], list[str]]:
    """Pictures of the frames whose log is there, and a line on each log that has to go without."""
    images: dict[Key, str] = {}
    notes: list[str] = []
    for run, tables in sources.items():
        for files in tables:
            wanted = [frame for frame in frames if frame.run == run and files.holds(frame.frame)]
            found, why = _of_log(wanted, files) if wanted or len(tables) == 1 else ({}, "")
            images |= found
            notes += [f"{run}: {why}"] if why else []
    return images, notes


def _of_log(frames: Sequence[WorstFrame], files: Sources) -> tuple[dict[Key, str], str]:
    log = files.present_log
    if log is None:
        name = files.log.name if files.log else "its log"
        return {}, f"{name} is not where the table says, so there are no pictures of its frames."
    images: dict[Key, str] = {}
    problems = Problems()
    try:
        if files.is_replayed_again(log):
            return (
                {},
                f"{log.name} was replayed again with another configuration, so it has no pictures of this run.",
            )
        for frame, image in _drawn(log, frames, problems):
            images[frame.run, frame.frame] = image
    except RoadpercError as error:
        return images, f"no more pictures: {str(error).replace(str(log), log.name)}"
    lacking = len(frames) - len(images)
    notes = [f"{log.name} holds no camera image of {lacking} of these frames."] if lacking else []
    notes += [f"What could not be read is not drawn: {'; '.join(problems.first.values())}."] if problems.first else []
    return images, " ".join(notes)


def _drawn(log: Path, frames: Sequence[WorstFrame], problems: Problems) -> Iterator[tuple[WorstFrame, str]]:
    """The frames of which the log has a camera image, each with its picture as a data URI."""
    found = _seen_in_order if any(frame.segment for frame in frames) else _seen_at_stamps
    return ((frame, data_uri(draw_results(seen, WIDTH_PX))) for frame, seen in found(log, frames, problems))


def _seen_at_stamps(log: Path, frames: Sequence[WorstFrame], problems: Problems) -> Iterator[Seen]:
    """Each frame as the log's part at its stamp has it."""
    for frame in frames:
        if seen := read_frame(log, frame.stamp_ns, problems):
            yield frame, seen


def _seen_in_order(log: Path, frames: Sequence[WorstFrame], problems: Problems) -> Iterator[Seen]:
    """The frames of a log in several segments: stamps come again there, so it is read from the beginning."""
    wanted = {frame.frame: frame for frame in frames}
    for row, seen in read_frames(summarise(log), problems):
        if seen and row.frame in wanted:
            yield wanted.pop(row.frame), seen
        if not wanted:
            return
