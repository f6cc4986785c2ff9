"""Pictures of the frames in which the new run is worse by most: base on the left, new on the right."""

import re
from pathlib import Path
from tempfile import gettempdir
from typing import Final

import numpy as np
import polars as pl

from roadperc_stream.errors import RoadpercError
from roadperc_stream.formats.images import encode_jpeg
from roadperc_stream.input.stream import Problems
from roadperc_stream.model import Image
from roadperc_stream.output.drawing.overlay import PerceivedFrame, Phrase, draw_captioned
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.system.files import scratch_folder, write_whole
from roadperc_stream.system.progress import Progress
from roadperc_stream.view.result_frames import read_frame

from ..html.pictures import drawn_from_log, frames_of, log_of
from ..replaying import Part, replayed
from ..runs import Run
from .comparison import Comparison
from .summary import values_at

_HALF_PX: Final = 640
_GAP_PX: Final = 6
_GREY: Final = 128
_JPEG_QUALITY: Final = 85
_NOT_IN_NAMES: Final = re.compile(r"[^\w.\-]+")
Pictures = tuple[list[tuple[str, Path]], list[str]]
"""The captions and files, and a line for each picture, or half of one, that could not be drawn."""


def draw_worst(found: Comparison, folder: Path) -> Pictures:
    """Write a picture of each of the worst frames into a folder, which may exist; no folder if no frame is worse.

    A frame whose result log was not kept is replayed with the recorded configuration from the recorded input.

    Raises:
        TargetError: the folder or a file cannot be written.
    """
    places, files, notes = found.worst_places, list[tuple[str, Path]](), list[str]()
    if not places:
        return files, ["no pictures: no frame is worse"]
    with scratch_folder(Path(gettempdir(), "roadperc-pictures")) as scratch, frame_progress("drawing", True) as bar:
        for rank, place in enumerate(places, 1):
            halves, (*values, unit) = [], values_at(place)
            sides = zip(("base", "new"), (place.pair.base, place.pair.new), values, strict=True)
            for side, run, value in sides:
                seen, lines = _seen(run, place.stamp_ns, scratch / f"{rank} {side}", bar)
                notes += [f"picture {rank}, {side}: {line}" for line in lines]
                measured = Phrase(f"{side}: {place.metric.label} {value}{unit}")
                phrases = measured, Phrase(f"frame {place.frame}")
                halves.append(None if seen is None else draw_captioned(seen, phrases, _HALF_PX))
            path = folder / f"{rank}_{_NOT_IN_NAMES.sub('-', place.pair.name)}_frame_{place.frame}.jpg"
            if any(half is not None for half in halves):
                _write(path, halves)
                label = f"{place.metric.label} {' → '.join(values)}{unit}"
                files.append((f"frame {place.frame} of {place.pair.name}: {label}; base left, new right", path))
    return files, notes


def _seen(run: Run, stamp_ns: int, scratch: Path, bar: Progress) -> tuple[PerceivedFrame | None, list[str]]:
    """A frame of a run from its result log, else from a replay; and why it or its picture is missing, or differs."""
    try:
        (frame, *_) = frames_of(run, pl.col("stamp_ns") == stamp_ns)
        table = run.table_of(frame.frame)
        log = log_of(table)
        if log is not None and log.is_file():
            key = frame.run, frame.frame
            images, why = drawn_from_log([frame], {key}, table, lambda seen: seen)
            return images.get(key), [why] if why else []
        scratch.mkdir()
        again = replayed(table, Part(frame.frame), {}, (), scratch, bar)
        seen = read_frame(again.log, stamp_ns, Problems())
    except RoadpercError as error:
        return None, [f"no picture: {error}"]
    return seen, [*again.notes, *([] if seen else ["no picture: the log has no camera image of the frame"])]


def _write(path: Path, halves: list[Image | None]) -> None:
    """Write both halves side by side; a missing one is grey."""
    rows = max(half.shape[0] for half in halves if half is not None)
    whole = np.full((rows, 2 * _HALF_PX + _GAP_PX, 3), _GREY, np.uint8)
    for left_px, half in zip((0, _HALF_PX + _GAP_PX), halves, strict=True):
        if half is not None:
            whole[: half.shape[0], left_px : left_px + _HALF_PX] = half
    write_whole(path, encode_jpeg(whole, _JPEG_QUALITY))
