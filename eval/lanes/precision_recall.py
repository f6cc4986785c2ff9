"""Precision, recall and F1 of counted outputs over many frames."""

from collections.abc import Mapping
from dataclasses import dataclass

from ..report_columns import COUNTED


@dataclass(frozen=True)
class Score:
    """Numbers of true positives, false positives and false negatives."""

    name: str
    tp: int
    fp: int
    fn: int

    @property
    def precision(self) -> float | None:
        """Share of the positives that are true; None without positives."""
        return _share(self.tp, self.tp + self.fp)

    @property
    def recall(self) -> float | None:
        """Share of the truth that was found; None without truth."""
        return _share(self.tp, self.tp + self.fn)

    @property
    def f1(self) -> float | None:
        """Harmonic mean of precision and recall, CULane's ranking; None without truth and positives."""
        return _share(2 * self.tp, 2 * self.tp + self.fp + self.fn)

    def cells(self, decimals: int) -> tuple[str, ...]:
        """Precision, recall and F1, empty if None, and the counts."""
        ratios = ("" if ratio is None else f"{ratio:.{decimals}f}" for ratio in (self.precision, self.recall, self.f1))
        return (*ratios, *map(str, (self.tp, self.fp, self.fn)))


def scores(totals: Mapping[str, int]) -> list[Score]:
    """Scores from the sums of the count columns over the frames; a score needs all three of its counts."""
    return [
        Score(name, *(totals[column] for column in columns))
        for name, columns in COUNTED.items()
        if all(column in totals for column in columns)
    ]


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
