"""A run's lanes against true ones in TuSimple's format: which frames belong together, and the scores over all."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

from roadperc_stream.core.geometry import Float
from roadperc_stream.metrics import lane_scores
from roadperc_stream.metrics.lane_scores import Counts, TuSimpleScore
from roadperc_stream.metrics.lanes import CULANE_THRESHOLDS as THRESHOLDS

from ..options import LanePairing
from ..scores import Score
from .recorded import RunFrame
from .tusimple import LaneFileError, LaneFrame


@dataclass(frozen=True)
class FrameScore:
    """The accuracy of one frame's lanes: TuSimple's figures, and CULane's counts at each of ``THRESHOLDS``."""

    tusimple: TuSimpleScore
    counts: tuple[Counts, ...]
    answered: bool
    """Whether the run saw any lane in it."""


@dataclass(frozen=True)
class LaneScores:
    """Means and sums over all true frames, those that the run lacks or is silent on included."""

    frames: int
    answered: int
    tusimple: TuSimpleScore
    culane: tuple[Score, ...]


def by_key(truth: Sequence[LaneFrame], pairing: LanePairing) -> dict[int, LaneFrame]:
    """True frames by their stamp in ns, which is the last part of ``raw_file``, or by their place in the file.

    Raises:
        LaneFileError: a ``raw_file`` names no stamp, or one that another line has named.
    """
    if pairing == "order":
        return dict(enumerate(truth))
    found: dict[int, LaneFrame] = {}
    for frame in truth:
        stamp_ns = _stamp_ns(frame)
        if stamp_ns in found:
            raise LaneFileError(f"{frame.place}: raw_file {frame.raw_file!r} again, after {found[stamp_ns].place}")
        found[stamp_ns] = frame
    return found


def _stamp_ns(frame: LaneFrame) -> int:
    stamp = PurePosixPath(frame.raw_file).stem
    if not (stamp.isascii() and stamp.isdecimal() and len(stamp) <= len(str(2**63))):
        raise LaneFileError(
            f"{frame.place}: unknown raw_file {frame.raw_file!r}; expected a frame's stamp in ns behind the last /, "
            "such as drive/1600000000000000000, or --pair order"
        )
    return int(stamp)


def paired(
    frames: Iterable[RunFrame], truth: Mapping[int, LaneFrame], pairing: LanePairing
) -> Iterator[tuple[RunFrame, LaneFrame]]:
    """A run's frames that have a truth, each with it, in the run's order.

    Raises:
        LaneFileError: paired by order, there are not as many true frames as frames in the run.
    """
    count = 0
    for count, frame in enumerate(frames, 1):
        key = frame.stamp_ns if pairing == "stamp" else count - 1
        if key in truth:
            yield frame, truth[key]
    if pairing == "order" and count != len(truth):
        source = next(iter(truth.values())).place.rpartition(":")[0]
        raise LaneFileError(f"{source}: {len(truth)} lines; expected {count}, one for each frame of the run, in order")


def score_frame(found: LaneFrame, truth: LaneFrame, size: tuple[int, int]) -> FrameScore:
    """Score one frame; thresholds in px scale with the image's width, which has the benchmark's 1280 and 1640 px.

    Args:
        found: lanes at the rows of ``truth``.
        truth: the true ones; for CULane those with two points or more.
        size: columns and rows of the image.
    """
    columns, rows = size
    threshold_px = lane_scores.tusimple_px(columns)
    width_px = lane_scores.culane_width_px(columns)
    overlaps = lane_scores.line_overlaps(_polylines(found), _polylines(truth), (rows, columns), width_px)
    return FrameScore(
        lane_scores.tusimple(found.lanes, truth.lanes, truth.rows, threshold_px),
        tuple(lane_scores.counts_above(overlaps, threshold) for threshold in THRESHOLDS),
        bool(found.lanes),
    )


def _polylines(frame: LaneFrame) -> list[Float]:
    """(N, 2) x, y of each lane that is a line."""
    lanes = (np.column_stack((lane, frame.rows))[np.isfinite(lane)] for lane in frame.lanes)
    return [lane for lane in lanes if len(lane) > 1]


def unanswered(truth: LaneFrame, size: tuple[int, int]) -> FrameScore:
    """The score of a frame that the run lacks: that of one without lanes."""
    return score_frame(LaneFrame(truth.raw_file, truth.rows, ()), truth, size)


def summed(scores: Sequence[FrameScore]) -> LaneScores:
    """TuSimple's figures as means over frames and CULane's counts as sums, as either benchmark does; of at least one.

    The ``run_time`` above which TuSimple's script refuses a frame (200 ms) is not applied to a replay.
    """
    counts = np.array([score.counts for score in scores]).sum(axis=0).tolist()
    named = zip(THRESHOLDS, counts, strict=True)
    return LaneScores(
        len(scores),
        sum(score.answered for score in scores),
        TuSimpleScore(*np.mean([score.tusimple for score in scores], axis=0).tolist()),
        tuple(Score(f"lanes at IoU {threshold:g}", *each) for threshold, each in named),
    )
