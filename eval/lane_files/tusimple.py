"""Lanes as TuSimple's JSON lines: an object a frame, each lane a column in px at each of the frame's rows."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, FiniteFloat, ValidationError

from roadperc_stream.core.files import completing, require_suffix
from roadperc_stream.core.geometry import Float
from roadperc_stream.errors import RoadpercError

NOWHERE: Final = -2
"""The column of a point that is not there; any negative one is read as such."""
FARTHEST_PX: Final = 1e9
"""A column or row farther out is no pixel of any image, and its square might not be a number."""
_DECIMALS: Final = 2


class LaneFileError(RoadpercError):
    """A file of lanes that is not what TuSimple's format says, or does not belong to the run."""


@dataclass(frozen=True)
class LaneFrame:
    """A frame's lanes: ``rows`` (N,) px, ``lanes`` a (N,) column in px each, NaN where there is no point.

    ``place`` says where the frame was read, as FILE:LINE, for errors.
    """

    raw_file: str
    rows: Float
    lanes: tuple[Float, ...]
    run_time_ms: float = 0.0
    place: str = ""


class _Line(BaseModel):
    """One line of a file, its keys in the order of the benchmark's own description."""

    model_config = ConfigDict(strict=True)

    raw_file: str
    lanes: list[list[int | FiniteFloat]]
    h_samples: list[int | FiniteFloat]
    run_time: FiniteFloat = 0.0


def to_line(frame: LaneFrame) -> str:
    """One frame as a line of JSON, columns rounded to hundredths of a pixel, which is exact for ``rounded`` ones."""
    lanes = [_numbers(np.nan_to_num(lane, nan=NOWHERE)) for lane in frame.lanes]
    run_time = round(frame.run_time_ms, _DECIMALS)
    line = _Line(raw_file=frame.raw_file, lanes=lanes, h_samples=_numbers(frame.rows), run_time=run_time)
    return line.model_dump_json() + "\n"


def _numbers(values: Float) -> list[int | float]:
    """Whole numbers without a point, as rows and absent points have none in the benchmark's files."""
    return [int(value) if value.is_integer() else round(value, _DECIMALS) for value in values.tolist()]


def rounded(lane: Float) -> Float:
    """A lane's columns as a file holds them: what is scored is what is written."""
    columns: Float = np.round(lane, _DECIMALS)
    return columns


def read_frames(path: Path) -> list[LaneFrame]:
    """The frames of a file, one a line; empty lines are passed over.

    Raises:
        LaneFileError: a line is not a JSON object of the format, or no line is there.
        OSError: the file cannot be read.
    """
    with path.open("rb") as stream:
        frames = [_frame(line, f"{path}:{k}") for k, line in enumerate(stream, 1) if line.strip()]
    if not frames:
        raise LaneFileError(f"{path}: no lines in this file; expected a JSON object for each frame")
    return frames


def _frame(text: bytes, place: str) -> LaneFrame:
    try:
        line = _Line.model_validate_json(text)
    except ValidationError as error:
        raise LaneFileError(f"{place}: is not a line of TuSimple's format: {_first(error)}") from error
    _require_lengths(line.lanes, len(line.h_samples), place)
    for name, values in (("h_samples", line.h_samples), *((f"lanes[{k}]", lane) for k, lane in enumerate(line.lanes))):
        _require_pixels(values, f"{place}: {name}")
    lanes = tuple(_unknown_as_nan(np.array(lane, float)) for lane in line.lanes)
    return LaneFrame(line.raw_file, np.array(line.h_samples, float), lanes, line.run_time, place)


def _first(error: ValidationError) -> str:
    found = error.errors(include_url=False)[0]
    key = ".".join(str(part) for part in found["loc"])
    return f"{key}: {found['msg']}" if key else found["msg"]


def _require_lengths(lanes: Sequence[Sequence[float]], rows: int, place: str) -> None:
    if not rows:
        raise LaneFileError(f"{place}: h_samples is empty; expected the rows at which lanes have columns")
    for k, lane in enumerate(lanes):
        if len(lane) != rows:
            raise LaneFileError(f"{place}: lanes[{k}] has {len(lane)} columns; expected {rows}, one for each h_sample")


def _require_pixels(values: Sequence[float], place: str) -> None:
    if any(not -FARTHEST_PX <= value <= FARTHEST_PX for value in values):
        raise LaneFileError(f"{place}: expected pixels from {-FARTHEST_PX:g} to {FARTHEST_PX:g}")


def _unknown_as_nan(lane: Float) -> Float:
    return np.where(lane < 0, np.nan, lane)


@contextmanager
def lane_writer(target: Path) -> Iterator[Callable[[LaneFrame], None]]:
    """A function that appends frames to a file, ``.json`` or ``.jsonl``, which has its name only when complete.

    Raises:
        TargetError: it cannot be written, or not under this name.
    """
    require_suffix(target, ".json", ".jsonl")
    with completing(target) as temporary, temporary.open("w", encoding="utf-8") as stream:
        yield lambda frame: _append(stream.write, frame)


def _append(write: Callable[[str], int], frame: LaneFrame) -> None:
    write(to_line(frame))
