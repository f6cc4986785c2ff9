"""Ranks the combinations of a sweep by each metric, and averages the scores of each value of a setting.

A score is the median of a metric's absolute value over the frames of all logs, or the mean of a share. Each score has
a coverage, the share of frames with a value, because a setting with lower coverage may have smaller errors.
"""

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import Final

import polars as pl

from roadperc_stream.output.tables import Scalar
from roadperc_stream.schemas.columns import RATIO, TIME_COLUMNS

from ..compare.metrics import METRICS as COMPARED
from ..report_columns import ERRORS, JITTERS, SIDES, TOTAL, Quantity
from ..runs import reading
from ..scan import finite, neighbour_columns
from .combinations import Combination

COVERAGE_SLACK: Final = 0.01
"""Largest difference from the highest coverage at which a setting can still be the best."""
TIME_NOISE: Final = 0.15
"""Ratio by which times differ between sweeps on a busy machine."""
_TABLE: Final = "table"


@dataclass(frozen=True)
class SweepMetric:
    """A metric of a combination: the ``value`` of a frame, and the ``score`` over all values.

    ``noise`` is the ratio by which a score varies from run to run.
    """

    quantity: Quantity
    value: pl.Expr
    score: pl.Expr
    noise: float = 0.0

    def badness(self, score: float) -> float:
        """A number that is larger for a worse score."""
        return -score if self.quantity.better == "high" else score

    def alike(self, scores: Iterable[float]) -> bool:
        """Whether scores are equal in the printed digits or within the noise."""
        ordered = sorted(scores)
        low, high = ordered[0], ordered[-1]
        decimals = self.quantity.decimals
        return round(low, decimals) == round(high, decimals) or high - low < self.noise * low


@dataclass(frozen=True)
class SettingScore:
    """Score of a combination, None without values, and the share of frames with a value."""

    value: float | None
    coverage: float


Scored = tuple[SweepMetric, Sequence[SettingScore]]
"""A metric, and the score of every combination."""


def _typical(quantity: Quantity) -> SweepMetric:
    """The median of the absolute value; for a share the mean, because most frames may have a share of 0 or 1."""
    value = pl.col("value")
    score = value.mean() if quantity.unit == RATIO else value.abs().median()
    return SweepMetric(quantity, finite([quantity.column])[0], score)


def _jitter(quantity: Quantity) -> SweepMetric:
    """Standard deviation of the smoothed offset's second difference, as the report computes it."""
    (column,) = (column for column in neighbour_columns() if column.meta.output_name() == quantity.column)
    value = column.over(_TABLE)
    return SweepMetric(quantity, pl.when(value.is_finite()).then(value), pl.col("value").std(ddof=0))


def _share(column: str, name: str, holds: pl.Expr | None = None) -> SweepMetric:
    """The share of frames in which an expression holds, by default of those with a value."""
    quantity = Quantity(column, name, RATIO, 3, better="high")
    known = finite([column])[0].is_not_null() if holds is None else holds
    return SweepMetric(quantity, known.cast(pl.Float64), pl.col("value").mean())


def _state(column: str, state: str, name: str) -> SweepMetric:
    """The share of frames with a state, as ``roadperc-compare`` judges it."""
    (metric,) = (metric for metric in COMPARED if metric.name == f"{column}.{state}")
    return _share(column, name, metric.value)


METRICS: Final = (
    *(_typical(quantity) for quantity in ERRORS),
    _share("camera_height_m", "surface coverage"),
    _share("drivable_ratio", "drivable coverage"),
    *(_state(f"lane_{side}_status", "measured", f"lane {side} measured") for side in SIDES),
    *(_share(f"lane_{side}_offset_m", f"lane {side} coverage") for side in SIDES),
    *(_jitter(quantity) for quantity in JITTERS if "raw" not in quantity.column),
    _state("odometry_status", "tracked", "odometry tracked"),
    replace(_typical(replace(TOTAL, name="time a frame", decimals=0)), noise=TIME_NOISE),
)
"""The errors against truth and by hindsight, and the metrics that need no errors."""


def scores(tables: Sequence[Path], made: Sequence[Combination], metric: SweepMetric) -> list[SettingScore]:
    """The score of each combination, over all its tables.

    Raises:
        TableError: the tables cannot be read.
    """
    keys = list(made[0].settings)
    frames = pl.scan_parquet(list(tables), glob=False, hive_partitioning=False, include_file_paths=_TABLE)
    query = (
        frames.select(*keys, metric.value.alias("value"))
        .group_by(keys)
        .agg(metric.score.alias("score"), (pl.col("value").count() / pl.len()).alias("coverage"))
    )
    with reading(str(tables[0].parent.parent)):
        rows = {row[:-2]: SettingScore(*row[-2:]) for row in query.collect().iter_rows()}
    return [rows[tuple(item.settings.values())] for item in made]


def best(
    metric: SweepMetric, found: Sequence[SettingScore], made: Sequence[Combination], reference: Combination
) -> tuple[int, int | None] | None:
    """Index of the best combination with the highest coverage, and of a better one with lower coverage.

    Among equal combinations, the best one has the fewest changes from the reference. The second index is None if there
    is no better combination. The result is None if no combination has a value.
    """

    def changes(item: Combination) -> int:
        return sum(item.settings[key] != value for key, value in reference.settings.items())

    def least_bad(values: Mapping[int, float]) -> int:
        least = min(values.values(), key=metric.badness)
        equals = [at for at, value in values.items() if metric.alike([value, least])]
        return min(equals, key=lambda at: (changes(made[at]), at))

    values = {at: score.value for at, score in enumerate(found) if score.value is not None}
    if not values:
        return None
    most = max(found[at].coverage for at in values)
    winner = least_bad({at: value for at, value in values.items() if found[at].coverage >= most - COVERAGE_SLACK})
    first = least_bad(values)
    return winner, None if metric.alike([values[first], values[winner]]) else first


def effect(found: Sequence[SettingScore], made: Sequence[Combination], key: str) -> dict[Scalar, SettingScore]:
    """Mean score and coverage of the combinations with each value of a setting."""
    having: dict[Scalar, list[SettingScore]] = {}
    for score, item in zip(found, made, strict=True):
        having.setdefault(item.settings[key], []).append(score)
    means = {}
    for value, scored in having.items():
        known = [score.value for score in scored if score.value is not None]
        means[value] = SettingScore(fmean(known) if known else None, fmean(score.coverage for score in scored))
    return means


def without_influence(folder: Path, tables: Sequence[Path], made: Sequence[Combination]) -> Iterator[str]:
    """The settings that change no column except times, for all values of the other settings.

    ``tables`` are the tables of all combinations, each below the folder of its combination.
    """
    results: dict[str, list[bytes]] = {}
    for path in tables:
        rows = pl.read_parquet(path, glob=False).drop(*TIME_COLUMNS, *made[0].settings, strict=False)
        digest = hashlib.sha256(rows.hash_rows().to_numpy().tobytes()).digest()
        results.setdefault(path.relative_to(folder).parts[0], []).append(digest)
    for key in made[0].settings:
        others = [tuple(value for name, value in item.settings.items() if name != key) for item in made]
        found = {(other, *results[item.folder]) for other, item in zip(others, made, strict=True)}
        if len(set(others)) < len(made) and len(found) == len(set(others)):
            yield key
