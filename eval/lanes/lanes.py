"""Exports a run's lanes as TuSimple's JSON lines, and scores them against true lanes."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple

import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.metrics.lanes import CULANE_THRESHOLDS as THRESHOLDS
from roadperc_stream.metrics.lanes import Counts, TuSimpleScore, counts_above, line_overlaps, tusimple
from roadperc_stream.output.terminal import console_for
from roadperc_stream.output.text_table import Table
from roadperc_stream.schemas.topics import LANES_TOPIC
from roadperc_stream.system.files import real_path
from roadperc_stream.system.text import listed, number, whole_number

from ..options import LanePairing
from ..report_columns import percent
from ..results import Results
from .lane_files import LaneFileError, LaneFrame, default_rows, image_name, lane_writer, read_frames, read_list
from .precision_recall import Score
from .run_lanes import RunFrame, RunLanes, lane_frame, open_lanes

NAMED: Final = 10
"""Missing frames that are listed by name."""
_NO_LANES: Final = f"no frame has a message on {LANES_TOPIC}; lanes need segmentation, such as that of roadperc-infer"
_EXPECTED_NAMES: Final = (
    "expected names that end in a frame's stamp in ns, or images of a dataset that roadperc-convert converted"
)
_Size = tuple[int, int]
_Write = Callable[[LaneFrame], object]


class FrameScore(NamedTuple):
    """TuSimple's scores of one frame, CULane's counts at each of ``THRESHOLDS``, and whether the run found a lane."""

    tusimple: TuSimpleScore
    counts: tuple[Counts, ...]
    has_lanes: bool


def print_lanes(
    path: Path, target: Path | None, true_lanes: Path | None, pairing: LanePairing, size: _Size | None
) -> None:
    """Export a run's lanes, and score them.

    Args:
        path: the log with results.
        target: the file to write, if any.
        true_lanes: the file with true lanes, if any.
        pairing: pairs true frames with the run's frames by stamp or by order.
        size: columns and rows of the image of both files' pixels; None for the camera's.

    Raises:
        LaneFileError: a file is not in TuSimple's or CULane's format, no line of it belongs to the run, or ``target``
            is ``true_lanes``.
        RoadpercError: the log cannot be read.
    """
    if target and true_lanes and real_path(target) == real_path(true_lanes):
        raise LaneFileError(f"{target}: is the file with the true lanes; pass another file to write")
    source = open_lanes(path)
    if not (source.has_lanes or true_lanes):
        raise LaneFileError(f"{path}: {_NO_LANES}")
    size = size or (source.camera.width, source.camera.height)
    lines = _read_truth(true_lanes, source, size) if true_lanes else []
    truth, pairing = _by_key(lines, pairing, source.images_ns)
    with lane_writer(target) as write:
        found = _write_and_score(source, truth, pairing, size, write) if truth else _export(source, size, write)
    others = f"left out: {number(len(lines) - len(truth), 'line')} of images that the log does not have"
    notes = [others] * (len(truth) < len(lines)) + [f"note: {_NO_LANES}"] * (not source.has_lanes)
    replace(found, tail=notes).print(console_for(sys.stdout))


def _read_truth(path: Path, source: RunLanes, size: _Size) -> list[LaneFrame]:
    """True frames of TuSimple's JSON lines, or of a list of CULane."""
    if path.suffix.lower() == ".txt":
        return read_list(path, source.images_ns, default_rows(size[1]))
    return read_frames(path)


def _by_key(
    truth: Sequence[LaneFrame], pairing: LanePairing, images_ns: Mapping[str, int]
) -> tuple[dict[int, LaneFrame], LanePairing]:
    """True frames by stamp in ns, or by their order in the file, and which of the two.

    If ``images_ns`` has the name of a true frame, it gives the stamps, and other frames are left out. Otherwise the
    stamp is the last component of ``raw_file``.
    """
    named = [frame for frame in truth if image_name(frame.raw_file) in images_ns]
    if pairing == "order" and not named:
        return dict(enumerate(truth)), pairing
    found: dict[int, LaneFrame] = {}
    for frame in named or truth:
        stamp_ns = images_ns[image_name(frame.raw_file)] if named else _stamp_ns(frame)
        if stamp_ns in found:
            other = found[stamp_ns].place
            raise LaneFileError(f"{frame.place}: raw_file {frame.raw_file!r} has the same stamp as {other}")
        found[stamp_ns] = frame
    return found, "stamp"


def _stamp_ns(frame: LaneFrame) -> int:
    stamp_ns = whole_number(PurePosixPath(frame.raw_file).stem)
    if stamp_ns is None:
        raise LaneFileError(
            f"{frame.place}: raw_file {frame.raw_file!r} has no stamp; expected a stamp in ns after the last /, "
            "such as drive/1600000000000000000, or pass --pair order"
        )
    return stamp_ns


def _export(source: RunLanes, size: _Size, write: _Write) -> Results:
    """Write every frame; the result is the number of frames and of frames with lanes."""
    name, rows = source.summary.path.stem, default_rows(size[1])
    has_lanes = []
    for frame in source.frames():
        found = lane_frame(frame, source.camera, size, f"{name}/{frame.stamp_ns}", rows)
        has_lanes.append(bool(found.lanes))
        write(found)
    return Results("lanes", "Lanes", [f"{name}: {len(has_lanes)} frames, lanes in {sum(has_lanes)}"])


def _write_and_score(
    source: RunLanes, truth: Mapping[int, LaneFrame], pairing: LanePairing, size: _Size, write: _Write
) -> Results:
    """Write and score the frames that have truth."""
    scores: list[FrameScore] = []
    missing = {true.raw_file: true for true in truth.values()}
    for frame, true in _paired(source, truth, pairing):
        found = lane_frame(frame, source.camera, size, true.raw_file, true.rows)
        write(found)
        scores.append(score_frame(found, true, size))
        missing.pop(true.raw_file, None)
    if not scores:
        place, run = next(iter(truth.values())).place, source.summary.path
        why = f"{place}: no line belongs to a frame of {run}; {_EXPECTED_NAMES}"
        raise LaneFileError(why if source.has_lanes else f"{run}: {_NO_LANES}")
    # a frame that the run lacks has no lanes
    scores += [score_frame(LaneFrame(name, true.rows, ()), true, size) for name, true in missing.items()]
    return _figures(source.summary.path.stem, scores, list(missing))


def _paired(
    source: RunLanes, truth: Mapping[int, LaneFrame], pairing: LanePairing
) -> Iterator[tuple[RunFrame, LaneFrame]]:
    """A run's frames that have truth, each with its truth, in the run's order."""
    count = 0
    for count, frame in enumerate(source.frames(), 1):
        key = frame.stamp_ns if pairing == "stamp" else count - 1
        if key in truth:
            yield frame, truth[key]
    if pairing == "order" and count != len(truth):
        path = next(iter(truth.values())).place.rpartition(":")[0]
        raise LaneFileError(f"{path}: {len(truth)} lines; expected {count}, one for each frame of the run")


def score_frame(found: LaneFrame, truth: LaneFrame, size: _Size) -> FrameScore:
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


def _figures(name: str, scores: Sequence[FrameScore], missing: Sequence[str]) -> Results:
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
    head = [
        f"{name}: {number(len(scores), 'true frame')}, lanes in {with_lanes} of them ({share} %)",
        *([f"missing in the run, scored as empty: {len(missing)}: {listed(missing, NAMED)}"] if missing else []),
    ]
    tables = [
        Table("TuSimple", ("frames %", "accuracy", "FP", "FN"), (("lane points", share, *points),)),
        Table("CULane", headers, tuple((score.name, share, *score.cells(4)) for score in culane)),
    ]
    return Results("lanes", "Lanes", head, tables)
