"""A run's lanes as TuSimple's JSON lines, and their score against true ones."""

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from roadperc_stream.core.files import real_path
from roadperc_stream.output.terminal import console_for, print_parts
from roadperc_stream.output.text_table import TextRow, TextTable, row

from .grid import percent
from .lane_files.recorded import RunLanes, default_rows, lane_frame, open_lanes
from .lane_files.scoring import FrameScore, LaneScores, by_key, paired, score_frame, summed, unanswered
from .lane_files.tusimple import LaneFileError, LaneFrame, lane_writer, read_frames
from .options import LanePairing
from .scores import Score

NAMED: Final = 10
"""Missing frames that are named; of more only the number."""


@dataclass(frozen=True)
class LaneOptions:
    """The files, and how their frames and pixels belong to the run's."""

    target: Path | None
    truth: Path | None
    pairing: LanePairing
    size: tuple[int, int] | None
    """Columns and rows; None for the camera's."""


def print_lanes(path: Path, options: LaneOptions) -> None:
    """Export a run's lanes, and score them.

    Args:
        path: the log with results.
        options: what to write, and what to score it against.

    Raises:
        LaneFileError: a file is not TuSimple's, or would be replaced by what it is compared with.
        RoadpercError: the log cannot be read.
    """
    if options.target and options.truth and real_path(options.target) == real_path(options.truth):
        raise LaneFileError(f"{options.target}: is the truth itself; expected another file to write")
    truth = by_key(read_frames(options.truth), options.pairing) if options.truth else {}
    source = open_lanes(path)
    size = options.size or (source.camera.width, source.camera.height)
    with lane_writer(options.target) if options.target else nullcontext(_pass) as write:
        parts = _score(source, truth, options.pairing, size, write) if truth else [_export(source, size, write)]
    print_parts(console_for(sys.stdout), *parts)


def _pass(_frame: LaneFrame) -> None:
    """Where nothing is to be written."""


def _export(source: RunLanes, size: tuple[int, int], write: Callable[[LaneFrame], None]) -> str:
    """Write every frame; how many there are, and in how many there are lanes."""
    rows = default_rows(size[1])
    frames = detected = 0
    for frames, frame in enumerate(source.frames(), 1):  # noqa: B007
        found = lane_frame(frame, source.camera, size, f"{source.summary.path.stem}/{frame.stamp_ns}", rows)
        detected += bool(found.lanes)
        write(found)
    return f"{source.summary.path.stem}: {frames} frames, lanes in {detected}"


def _score(
    source: RunLanes,
    true_frames: Mapping[int, LaneFrame],
    pairing: LanePairing,
    size: tuple[int, int],
    write: Callable[[LaneFrame], None],
) -> list[str | TextTable]:
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
    return [_coverage(source.summary.path.stem, result), *_missing(list(missing)), _points(result), _lines(result)]


def _coverage(name: str, scores: LaneScores) -> str:
    share = percent(scores.answered / scores.frames)
    return f"{name}: {scores.frames} true frames, lanes in {scores.answered} of them ({share} %)"


def _missing(names: Sequence[str]) -> list[str]:
    """The true frames that the run lacks, by name; nothing where there are none."""
    rest = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return [f"missing in the run, scored as empty: {len(names)}: {', '.join(names[:NAMED])}{rest}"] if names else []


def _points(scores: LaneScores) -> TextTable:
    shares = (f"{value:.4f}" for value in scores.tusimple)
    found = row("lane points", percent(scores.answered / scores.frames), *shares)
    return TextTable("TuSimple", ("frames %", "accuracy", "FP", "FN"), (found,))


def _lines(scores: LaneScores) -> TextTable:
    headers = ("frames %", "precision", "recall", "F1", "TP", "FP", "FN")
    answered = percent(scores.answered / scores.frames)
    return TextTable("CULane", headers, tuple(_line(score, answered) for score in scores.culane))


def _line(score: Score, answered: str) -> TextRow:
    ratios = ("" if ratio is None else f"{ratio:.4f}" for ratio in (score.precision, score.recall, score.f1))
    return row(score.name, answered, *ratios, *(str(count) for count in (score.tp, score.fp, score.fn)))
