"""What a whole run says and no single frame can: counts summed to precision, recall and F1, and how far lanes lag."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import polars as pl

from .quantities import SIDES
from .segments import before

_COUNTED: Final = {
    "detections kept": ("filter_tp", "filter_fp", "filter_fn"),
    "lanes at IoU 0.5": ("lane_culane_tp_50", "lane_culane_fp_50", "lane_culane_fn_50"),
    "lanes at IoU 0.3": ("lane_culane_tp_30", "lane_culane_fp_30", "lane_culane_fn_30"),
}
COUNTS: Final = tuple(column for columns in _COUNTED.values() for column in columns)
"""Columns whose sums over a run are the counts of its scores."""
TRACED: Final = {side: (f"lane_{side}_offset_m", f"lane_{side}_true_offset_m") for side in SIDES}
"""What is smoothed and might lag, and the truth it follows."""
_FARTHEST: Final = 6
_SHIFTS: Final = tuple(sorted(range(-_FARTHEST, _FARTHEST + 1), key=abs))
"""Frames by which an estimate may lie behind its truth, the likeliest first: that decides between equals."""
_FOLLOWS: Final = 0.5
"""A correlation below says that estimate and truth do not move together, as on a road that does not bend."""
_DISTINCT: Final = 1.25
"""How much more of the variance other shifts leave unexplained than the one that is reported."""
_ROUNDING: Final = 1e-9
_FEWEST: Final = 3
"""Frames below which two columns always correlate."""


@dataclass(frozen=True)
class Score:
    """How many were found rightly, found wrongly and missed."""

    name: str
    tp: int
    fp: int
    fn: int

    @property
    def precision(self) -> float | None:
        """Share of what was found that is correct; None where nothing was found."""
        return _share(self.tp, self.tp + self.fp)

    @property
    def recall(self) -> float | None:
        """Share of what is there that was found; None where nothing is there."""
        return _share(self.tp, self.tp + self.fn)

    @property
    def f1(self) -> float | None:
        """Harmonic mean of precision and recall, by which CULane ranks; None where nothing is there nor was found."""
        return _share(2 * self.tp, 2 * self.tp + self.fp + self.fn)


def scores(totals: Mapping[str, int]) -> list[Score]:
    """The scores whose three counts are known, from the sums of ``COUNTS`` over the frames."""
    return [
        Score(name, *(totals[column] for column in columns))
        for name, columns in _COUNTED.items()
        if all(column in totals for column in columns)
    ]


def correlations(estimate: str, truth: str) -> pl.Expr:
    """Pearson's coefficient of two columns per shift within a segment: a list, each of the frames where both are known.

    Null or not finite where they are known together in fewer than half of the frames, or one does not vary there.
    """
    return pl.concat_list(_correlation(before(pl.col(estimate), -shift), pl.col(truth)) for shift in _SHIFTS)


def _correlation(a: pl.Expr, b: pl.Expr) -> pl.Expr:
    enough = (a.is_not_null() & b.is_not_null()).sum() >= pl.max_horizontal(pl.len() / 2, _FEWEST)
    return pl.when(enough).then(pl.corr(a, b))  # of the frames where both are known


def lag_frames(coefficients: Sequence[float | None]) -> int | None:
    """Frames by which an estimate lies behind its truth: the shift with the largest of ``correlations``.

    None where the largest is at the end of the shifts, for beyond it may lie a larger one, and where no shift stands
    out: the two do not move together, or so evenly that shifts of two frames and more
    leave hardly more of the one unexplained by the other (on a straight line any shift does).
    """
    pairs = zip(coefficients, _SHIFTS, strict=False)
    known = {shift: value for value, shift in pairs if value is not None and math.isfinite(value)}
    shift = max(known, key=lambda k: known[k], default=0)
    unexplained = {k: 1 - value * abs(value) for k, value in known.items()}
    others = min((share for k, share in unexplained.items() if abs(k - shift) > 1), default=math.inf)
    stands_out = known.get(shift, 0.0) >= _FOLLOWS and others > _DISTINCT * unexplained[shift] + _ROUNDING
    return shift if stands_out and abs(shift) < _FARTHEST else None


def averaged(parts: Iterable[tuple[int, Sequence[float | None]]]) -> tuple[float | None, ...]:
    """Correlations over several tables, from each one's frames and correlations; empty where none has a lag."""
    lagging = [(frames, coefficients) for frames, coefficients in parts if lag_frames(coefficients) is not None]
    total = sum(frames for frames, _ in lagging)
    by_shift = zip(
        *([frames / total * (c or 0.0) for c in coefficients] for frames, coefficients in lagging), strict=True
    )
    return tuple(sum(shares) for shares in by_shift)


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
