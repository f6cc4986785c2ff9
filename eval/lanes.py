"""Exports a run's lanes as TuSimple's JSON lines, and scores them against true lanes."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple

import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.metrics.lanes import CULANE_THRESHOLDS as THRESHOLDS
from roadperc_stream.metrics.lanes import Counts, TuSimpleScore, counts_above, line_overlaps, tusimple
from roadperc_stream.output.terminal import console_for, print_parts
from roadperc_stream.output.text_table import TextTable, row
from roadperc_stream.system.files import real_path

from . import lane_files
from .lane_files import LaneFileError, LaneFrame, RunFrame, RunLanes
from .options import LanePairing
from .quantities import listed, percent
from .scores import Score

NAMED: Final = 10
"""Missing frames that are listed by name."""


class FrameScore(NamedTuple):
    """TuSimple's scores of one frame, CULane's counts at each of ``THRESHOLDS``, and whether the run found a lane."""

    tusimple: TuSimpleScore
    counts: tuple[Counts, ...]
    has_lanes: bool


def by_key(truth: Sequence[LaneFrame], pairing: LanePairing) -> dict[int, LaneFrame]:
    """True frames by stamp in ns, from the last component of ``raw_file``, or by their order in the file.

    Raises:
        LaneFileError: a ``raw_file`` has no stamp, or the stamp of another line.
    """
    if pairing == "order":
        return dict(enumerate(truth))
    found: dict[int, LaneFrame] = {}
    for frame in truth:
        stamp = PurePosixPath(frame.raw_file).stem
        if not (stamp.isascii() and stamp.isdecimal() and len(stamp) <= len(str(2**63))):
            raise LaneFileError(
                f"{frame.place}: raw_file {frame.raw_file!r} has no stamp; expected a stamp in ns after the last /, "
                "such as drive/1600000000000000000, or pass --pair order"
            )
        if int(stamp) in found:
            other = found[int(stamp)].place
            raise LaneFileError(f"{frame.place}: raw_file {frame.raw_file!r} has the same stamp as {other}")
        found[int(stamp)] = frame
    return found


def paired(
    frames: Iterable[RunFrame], truth: Mapping[int, LaneFrame], pairing: LanePairing
) -> Iterator[tuple[RunFrame, LaneFrame]]:
    """A run's frames that have truth, each with its truth, in the run's order.

    Raises:
        LaneFileError: with ``order``, the numbers of true frames and of frames in the run differ.
    """
    count = 0
    for count, frame in enumerate(frames, 1):
        key = frame.stamp_ns if pairing == "stamp" else count - 1
        if key in truth:
            yield frame, truth[key]
    if pairing == "order" and count != len(truth):
        source = next(iter(truth.values())).place.rpartition(":")[0]
        raise LaneFileError(f"{source}: {len(truth)} lines; expected {count}, one for each frame of the run")


def score_frame(found: LaneFrame, truth: LaneFrame, size: tuple[int, int]) -> FrameScore:
    """Score one frame; thresholds in px scale with the image's width relative to 1280 and 1640 px in the benchmarks.

    Args:
        found: lanes at the rows of ``truth``.
        truth: true lanes; CULane uses those with two points or more.
        size: columns and rows of the image.
    """
    columns, rows = size
    overlaps = line_overlaps(_polylines(found), _polylines(truth), (rows, columns))
    return FrameScore(
        tusimple(found.lanes, truth.lanes, truth.rows, columns),
        tuple(counts_above(overlaps, threshold) for threshold in THRESHOLDS),
        bool(found.lanes),
    )


def _polylines(frame: LaneFrame) -> list[Float]:
    """(N, 2) x, y of each lane with two points or more."""
    lanes = (np.column_stack((lane, frame.rows))[np.isfinite(lane)] for lane in frame.lanes)
    return [lane for lane in lanes if len(lane) > 1]


def print_lanes(
    path: Path, target: Path | None, true_lanes: Path | None, pairing: LanePairing, size: tuple[int, int] | None
) -> None:
    """Export a run's lanes, and score them.

    Args:
        path: the log with results.
        target: the file to write, if any.
        true_lanes: the file with true lanes, if any.
        pairing: pairs true frames with the run's frames by stamp or by order.
        size: columns and rows of the image of both files' pixels; None for the camera's.

    Raises:
        LaneFileError: a file is not in TuSimple's format, or ``target`` is ``true_lanes``.
        RoadpercError: the log cannot be read.
    """
    if target and true_lanes and real_path(target) == real_path(true_lanes):
        raise LaneFileError(f"{target}: is the file with the true lanes; pass another file to write")
    truth = by_key(lane_files.read_frames(true_lanes), pairing) if true_lanes else {}
    source = lane_files.open_lanes(path)
    size = size or (source.camera.width, source.camera.height)
    with lane_files.lane_writer(target) as write:
        parts = _write_and_score(source, truth, pairing, size, write) if truth else [_export(source, size, write)]
    print_parts(console_for(sys.stdout), *parts)


def _export(source: RunLanes, size: tuple[int, int], write: Callable[[LaneFrame], object]) -> str:
    """Write every frame; a line with the number of frames and of frames with lanes."""
    name, rows = source.summary.path.stem, lane_files.default_rows(size[1])
    has_lanes = []
    for frame in source.frames():
        found = lane_files.lane_frame(frame, source.camera, size, f"{name}/{frame.stamp_ns}", rows)
        has_lanes.append(bool(found.lanes))
        write(found)
    return f"{name}: {len(has_lanes)} frames, lanes in {sum(has_lanes)}"


def _write_and_score(
    source: RunLanes,
    true_frames: Mapping[int, LaneFrame],
    pairing: LanePairing,
    size: tuple[int, int],
    write: Callable[[LaneFrame], object],
) -> list[str | TextTable]:
    """Write and score the frames that have truth; the lines and tables to print."""
    scores: list[FrameScore] = []
    missing = {truth.raw_file: truth for truth in true_frames.values()}
    for frame, truth in paired(source.frames(), true_frames, pairing):
        found = lane_files.lane_frame(frame, source.camera, size, truth.raw_file, truth.rows)
        write(found)
        scores.append(score_frame(found, truth, size))
        missing.pop(truth.raw_file, None)
    # a frame that the run lacks has no lanes
    scores += [score_frame(LaneFrame(name, truth.rows, ()), truth, size) for name, truth in missing.items()]
    return _figures(source.summary.path.stem, scores, list(missing))


def _figures(name: str, scores: Sequence[FrameScore], missing: Sequence[str]) -> list[str | TextTable]:
    """TuSimple's scores as means over frames and CULane's counts as sums, as in the benchmarks; at least one score.

    ``scores`` are of all true frames, including the ``missing`` ones, which the run lacks. TuSimple's limit of
    ``run_time`` (200 ms) does not apply to a replay.
    """
    with_lanes = sum(score.has_lanes for score in scores)
    share = percent(with_lanes / len(scores))
    points = (f"{value:.4f}" for value in np.mean([score.tusimple for score in scores], axis=0).tolist())
    counts = np.array([score.counts for score in scores]).sum(axis=0).tolist()
    culane = (Score(f"lanes at IoU {limit:g}", *each) for limit, each in zip(THRESHOLDS, counts, strict=True))
    headers = ("frames %", "precision", "recall", "F1", "TP", "FP", "FN")
    return [
        f"{name}: {len(scores)} true frames, lanes in {with_lanes} of them ({share} %)",
        *([f"missing in the run, scored as empty: {len(missing)}: {listed(missing, NAMED)}"] if missing else []),
        TextTable("TuSimple", ("frames %", "accuracy", "FP", "FN"), (row("lane points", share, *points),)),
        TextTable("CULane", headers, tuple(row(score.name, share, *score.cells(4)) for score in culane)),
    ]
