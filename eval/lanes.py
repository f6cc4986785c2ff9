"""A run's lanes as TuSimple's JSON lines, and their score against true ones."""

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.table import Table

from roadperc_stream.terminal import console_for, grid, print_lines

from .grid import percent
from .lane_files.recorded import RunLanes, default_rows, lane_frame, open_lanes
from .lane_files.scoring import FrameScore, LaneScores, by_key, paired, score_frame, summed, unanswered
from .lane_files.tusimple import LaneFileError, LaneFrame, lane_writer, read_frames
from .options import LanePairing

NAMED: Final = 10
"""Missing frames that are named; of more the number is told."""


@dataclass(frozen=True)
class Options:
    """The files, and how their frames and pixels belong to the run's."""

    target: Path | None
    truth: Path | None
    pairing: LanePairing
    size: tuple[int, int] | None
    """Columns and rows; None for the camera's."""


def print_lanes(path: Path, options: Options) -> None:
    """Export a run's lanes, and score them.

    Args:
        path: the log with results.
        options: what to write, and what to score it against.

    Raises:
        LaneFileError: a file is not TuSimple's, or would be replaced by what it is compared with.
        RoadpercError: the log cannot be read.
    """
    if options.target and options.truth and options.target.resolve() == options.truth.resolve():
        raise LaneFileError(f"{options.target}: is the truth itself; expected another file to write")
    truth = by_key(read_frames(options.truth), options.pairing) if options.truth else {}
    source = open_lanes(path)
    size = options.size or (source.camera.width, source.camera.height)
    with lane_writer(options.target) if options.target else nullcontext(_pass) as write:
        lines = _score(source, truth, options.pairing, size, write) if truth else [_export(source, size, write)]
    print_lines(console_for(sys.stdout), *lines, unbroken=True)


def _pass(_frame: LaneFrame) -> None:
    """Where nothing is to be written."""


def _export(source: RunLanes, size: tuple[int, int], write: Callable[[LaneFrame], None]) -> str:
    """Write every frame; how many there are, and in how many there are lanes."""
    rows = default_rows(size[1])
    frames = seen = 0
    for frames, frame in enumerate(source.frames(), 1):  # noqa: B007
        found = lane_frame(frame, source.camera, size, f"{source.path.stem}/{frame.stamp_ns}", rows)
        seen += bool(found.lanes)
        write(found)
    return f"{source.path.stem}: {frames} frames, lanes in {seen}"


def _score(
    source: RunLanes,
    true_frames: Mapping[int, LaneFrame],
    pairing: LanePairing,
    size: tuple[int, int],
    write: Callable[[LaneFrame], None],
) -> list[str | Table]:
    """Write and score the frames that have a truth; what there is to say of them."""
    scores: list[FrameScore] = []
    missing = {truth.raw_file: truth for truth in true_frames.values()}
    for frame, truth in paired(source.frames(), true_frames, pairing):
        found = lane_frame(frame, source.camera, size, truth.raw_file, truth.rows)
        write(found)
        scores.append(score_frame(found, truth, size))
        missing.pop(truth.raw_file, None)
    scores += [unanswered(truth, size) for truth in missing.values()]
    result = summed(scores)
    return [_coverage(source.path.stem, result), *_missing(list(missing)), "", _points(result), "", _lines(result)]


def _coverage(name: str, scores: LaneScores) -> str:
    share = percent(scores.answered / scores.frames)
    return f"{name}: {scores.frames} true frames, lanes in {scores.answered} of them ({share} %)"


def _missing(names: Sequence[str]) -> list[str]:
    """The true frames that the run lacks, by name; nothing where there are none."""
    rest = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return [f"missing in the run, scored as empty: {len(names)}: {', '.join(names[:NAMED])}{rest}"] if names else []


def _points(scores: LaneScores) -> Table:
    table = grid("TuSimple", "frames %", "accuracy", "FP", "FN")
    shares = (f"{value:.4f}" for value in scores.tusimple)
    table.add_row("lane points", percent(scores.answered / scores.frames), *shares)
    return table


def _lines(scores: LaneScores) -> Table:
    table = grid("CULane", "frames %", "precision", "recall", "F1", "right", "wrong", "missed")
    for score in scores.culane:
        ratios = ("" if ratio is None else f"{ratio:.4f}" for ratio in (score.precision, score.recall, score.f1))
        counts = (str(count) for count in (score.tp, score.fp, score.fn))
        table.add_row(score.name, percent(scores.answered / scores.frames), *ratios, *counts)
    return table
