"""Files of lanes: TuSimple's JSON lines, read and written, and the lists of CULane, read.

Each line of TuSimple is a JSON object for one frame. A lane is a list of columns in px, one for each of the frame's
rows. Each line of a list of CULane begins with the path of an image, whose true lanes are in a file beside it.
"""

import io
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from roadperc_stream.config.complaints import complaint, key_of
from roadperc_stream.errors import RoadpercError
from roadperc_stream.geometry import Float
from roadperc_stream.metrics.lanes import ROW_STEP_PX
from roadperc_stream.system.files import completing, is_inside, read_file, require_suffix

ABSENT_PX: Final = -2
"""The written column of an absent point; any negative column is read as absent."""
FARTHEST_PX: Final = 1e9
"""Largest absolute column or row that is accepted, so that squares stay finite."""
DECIMALS: Final = 2
_MOST_BYTES: Final = 1_000_000_000
"""Largest file; the lists of CULane have 10 MB."""
_TOP: Final = 160 / 720
"""TuSimple's first row as a ratio of the image's height."""


class LaneFileError(RoadpercError):
    """A file of lanes is not in TuSimple's or CULane's format, or does not belong to the run."""


@dataclass(frozen=True)
class LaneFrame:
    """A frame's lanes: ``rows`` (N,) px; each lane has (N,) columns in px, NaN if absent.

    ``place`` is the frame's FILE:LINE for error messages.
    """

    raw_file: str
    rows: Float
    lanes: tuple[Float, ...]
    run_time_ms: float = 0.0
    place: str = ""


_Pixel = Annotated[int | FiniteFloat, Field(ge=-FARTHEST_PX, le=FARTHEST_PX)]


class _Line(BaseModel):
    """One line of a file, its keys in the order of the benchmark's own description."""

    model_config = ConfigDict(strict=True)

    raw_file: str
    lanes: list[list[_Pixel]]
    h_samples: list[_Pixel] = Field(min_length=1)
    run_time: FiniteFloat = 0.0


def default_rows(height: int) -> Float:
    """TuSimple's rows: multiples of 10 px from 160 to 710 for a height of 720, and the same ratio of other heights."""
    return np.arange(np.ceil(height * _TOP / ROW_STEP_PX) * ROW_STEP_PX, height, ROW_STEP_PX)


def image_name(raw_file: str) -> str:
    """The path of an image from its dataset's folder on."""
    return PurePosixPath(raw_file.lstrip("/")).as_posix()


@contextmanager
def lane_writer(target: Path | None) -> Iterator[Callable[[LaneFrame], object]]:
    """A function that appends frames to a ``.json`` or ``.jsonl`` file, or does nothing without a target.

    The file is a partial file until it is complete.

    Raises:
        TargetError: the file cannot be written, or has another suffix.
    """
    if target is None:
        yield lambda _frame: None
        return
    require_suffix(target, ".json", ".jsonl")
    with completing(target) as temporary, temporary.open("w", encoding="utf-8") as stream:
        yield lambda frame: stream.write(to_line(frame))


def to_line(frame: LaneFrame) -> str:
    """One frame as a line of JSON, columns rounded to hundredths of a pixel."""
    lanes = [_numbers(np.nan_to_num(lane, nan=ABSENT_PX)) for lane in frame.lanes]
    run_time = round(frame.run_time_ms, DECIMALS)
    # without validation: a small image may have none of TuSimple's rows; only files to read must have one
    rows = _numbers(frame.rows)
    line = _Line.model_construct(raw_file=frame.raw_file, lanes=lanes, h_samples=rows, run_time=run_time)
    return line.model_dump_json() + "\n"


def _numbers(values: Float) -> list[int | float]:
    """Values with whole numbers as integers, as in the benchmark's files."""
    return [int(value) if value.is_integer() else round(value, DECIMALS) for value in values.tolist()]


def read_frames(path: Path) -> list[LaneFrame]:
    """The frames of a file of TuSimple, one for each line; empty lines are skipped.

    Raises:
        LaneFileError: a line is not a JSON object of the format, or the file is empty.
        OSError: the file cannot be read.
    """
    lines = read_file(path, _MOST_BYTES).split(b"\n")
    frames = [_frame(line, f"{path}:{k}") for k, line in enumerate(lines, 1) if line.strip()]
    if not frames:
        raise LaneFileError(f"{path}: no lines in this file; expected a JSON object for each frame")
    return frames


def _frame(text: bytes, place: str) -> LaneFrame:
    try:
        line = _Line.model_validate_json(text)
    except ValidationError as error:
        found = error.errors(include_url=False)[0]
        why = ": ".join(filter(None, (key_of(found["loc"]), complaint(found))))
        raise LaneFileError(f"{place}: is not in TuSimple's format: {why}") from error
    rows = len(line.h_samples)
    for k, lane in enumerate(line.lanes):
        if len(lane) != rows:
            raise LaneFileError(f"{place}: lanes[{k}] has {len(lane)} columns; expected {rows}, one per h_sample")
    lanes = tuple(_absent_if_negative(np.array(lane, float)) for lane in line.lanes)
    return LaneFrame(line.raw_file, np.array(line.h_samples, float), lanes, line.run_time, place)


def _absent_if_negative(columns: Float) -> Float:
    return np.where(columns < 0, np.nan, columns)


def read_list(path: Path, images: Collection[str], rows: Float) -> list[LaneFrame]:
    """The frames of a list of CULane that are among ``images``, with their true lanes at ``rows``.

    The lists name images from the dataset's folder on: ``/driver_23_30frame/05151640_0419.MP4/00030.jpg``.

    Raises:
        LaneFileError: the list names none of the images, or their lanes are wrong or not below a parent of the list.
        OSError: a file cannot be read.
    """
    lines = ((k, line.split(maxsplit=1)) for k, line in enumerate(_lines_of(path), 1))
    listed = {name: k for k, words in lines if words and (name := image_name(words[0])) in images}
    if not listed:
        example = min(images, default="those of a dataset that roadperc-convert converted")
        raise LaneFileError(f"{path}: names no image of the log; expected names such as {example}")
    labels = {name: PurePosixPath(name).with_suffix(".lines.txt") for name in listed}
    first = next(iter(labels.values()))
    folder = next((folder for folder in path.absolute().parents if (folder / first).is_file()), None)
    if folder is None:
        raise LaneFileError(f"{path}: no {first} in its folder or above it; expected the list of CULane in list/")
    frames = []
    for name, k in listed.items():
        if not is_inside(folder / labels[name], folder):
            raise LaneFileError(f"{path}:{k}: {name} leads out of {folder}; copy the files into this folder")
        lanes = _interpolated(folder / labels[name], rows)
        frames.append(LaneFrame(name, rows, lanes, place=f"{path}:{k}"))
    return frames


def _interpolated(path: Path, rows: Float) -> tuple[Float, ...]:
    """The lanes of a file of CULane at rows, interpolated between their points."""
    lanes = []
    for k, text in enumerate(_lines_of(path), 1):
        try:
            x, y = np.array(text.split(), np.float64).reshape(-1, 2).T
        except ValueError:
            x = y = np.array([np.nan])
        if not (np.abs((x, y)) <= FARTHEST_PX).all():
            raise LaneFileError(f"{path}:{k}: expected pairs of x and y in px, found {text[:60]!r}")
        order = np.argsort(y)
        if len(y):
            lanes.append(_absent_if_negative(np.interp(rows, y[order], x[order], left=np.nan, right=np.nan)))
    return tuple(lanes)


def _lines_of(path: Path) -> io.StringIO:
    return io.StringIO(read_file(path, _MOST_BYTES).decode("utf-8", "replace"))
