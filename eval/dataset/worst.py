"""The worst logs of a dataset, and the frames to look at in them: read again, each from the files it stands in."""

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import polars as pl

from roadperc_stream.schemas.columns import RATIO

from ..quantities import COVERED, SUSPECT, TRUTH, Quantity
from ..runs import collect
from ..scan import scanned, worst_frames
from .keys import LOG
from .place import scan_tables
from .reading import FILES, FRAMES, RANKED, summed, valued

LogKey = tuple[str, str]
"""Log and configuration."""
_AT_ONCE: Final = 2


@dataclass(frozen=True)
class LookAt:
    """A frame of a log, seconds from its first one, and the value there."""

    frame: int
    since_start_s: float
    value: float


@dataclass(frozen=True)
class WorstLog:
    """One of the worst logs by a quantity.

    ``mean`` is of the absolute values, of what is better high of the values; ``share`` of the frames have one.
    """

    log: LogKey
    mean: float
    share: float
    frames: tuple[LookAt, ...]


@dataclass(frozen=True)
class LeastCovered:
    """A log in which few frames have an output: their ``share``, and the longest stretch without, both frames in it."""

    log: LogKey
    share: float
    first: LookAt
    last: LookAt


@dataclass(frozen=True)
class WorstLogs:
    """The worst logs by each quantity that any has, and by the share of frames that have each output."""

    by_quantity: Mapping[Quantity, tuple[WorstLog, ...]]
    by_coverage: Mapping[str, tuple[LeastCovered, ...]]

    @property
    def logs(self) -> list[LogKey]:
        """All that are named, once each."""
        worst = [item.log for items in self.by_quantity.values() for item in items]
        uncovered = [item.log for items in self.by_coverage.values() for item in items]
        return list(dict.fromkeys((*worst, *uncovered)))


def worst_logs(logs: pl.DataFrame, number: int) -> WorstLogs:
    """The worst logs, so many of each, with as many frames to look at.

    Errors against truth rank them, else signs of trouble that need none. A log in which no frame could be better is
    none of the worst.

    Args:
        logs: as ``logs_of`` gives them.
        number: of logs, and of frames in each.

    Raises:
        TableError: a table cannot be read.
    """
    by_quantity = {quantity: _worst(logs, quantity, number) for quantity in _ranked_by(logs)}
    by_coverage = {name: _uncovered(logs, column, number) for name, column in COVERED.items()}
    wanted: dict[LogKey, list[pl.Expr]] = {}
    for quantity, rows in by_quantity.items():
        for row in rows.iter_rows(named=True):
            wanted.setdefault(_key(row), []).append(worst_frames(quantity, number))
    for name, rows in by_coverage.items():
        for row in rows.iter_rows(named=True):
            wanted.setdefault(_key(row), []).append(_longest_without(COVERED[name]))
    found = _read(logs, wanted)
    return WorstLogs(
        {
            q: tuple(_worst_log(row, found[_key(row)], q.column) for row in rows.iter_rows(named=True))
            for q, rows in by_quantity.items()
            if rows.height
        },
        {
            name: tuple(_least_covered(row, found[_key(row)], COVERED[name]) for row in rows.iter_rows(named=True))
            for name, rows in by_coverage.items()
            if rows.height
        },
    )


def _ranked_by(logs: pl.DataFrame) -> list[Quantity]:
    """What logs are the worst by: the errors there are, else signs of trouble."""
    having = {q.column for q in RANKED if logs[valued(q.column)].sum()}
    return [q for q in TRUTH if q.column in having] or [q for q in SUSPECT if q.column in having]


def _mean_badness(quantity: Quantity) -> pl.Expr:
    """How bad a log is, the larger the worse: the mean over the frames with a value; null without any."""
    mean = pl.col(summed(quantity.column)) / pl.col(valued(quantity.column))
    return pl.when(pl.col(valued(quantity.column)) > 0).then(-mean if quantity.worse == "low" else mean)


def _worst(logs: pl.DataFrame, quantity: Quantity, number: int) -> pl.DataFrame:
    best = (-1.0 if quantity.unit == RATIO else -math.inf) if quantity.worse == "low" else 0.0
    ranked = logs.with_columns(_mean_badness(quantity).alias("bad")).filter(pl.col("bad") > best)
    return _each_once(ranked.sort("bad", *LOG, descending=[True, False, False]), number)


def _uncovered(logs: pl.DataFrame, column: str, number: int) -> pl.DataFrame:
    """The logs with the least share of frames with a value, where that is not all, and the configuration gives any."""
    given = logs.filter(pl.col(valued(column)).sum().over("config") > 0)  # else it was switched off
    ranked = given.with_columns((pl.col(valued(column)) / pl.col(FRAMES)).alias("share"))
    return _each_once(ranked.filter(pl.col("share") < 1).sort("share", *LOG), number)


def _each_once(ranked: pl.DataFrame, number: int) -> pl.DataFrame:
    """The first logs, each under the configuration where it comes first."""
    return ranked.unique("log_id", keep="first", maintain_order=True).head(number)


def _longest_without(column: str) -> pl.Expr:
    """First and last frame of the longest stretch of frames without a value, the first of equals: a struct."""
    without = pl.col(column).is_null()
    stretch = without.rle_id().filter(without)
    longest = stretch == stretch.mode().min()
    rows = pl.struct("frame", "since_start_s").filter(without).filter(longest)
    return pl.struct(rows.first().alias("first"), rows.last().alias("last")).alias(f"without {column}")


def _read(logs: pl.DataFrame, wanted: Mapping[LogKey, list[pl.Expr]]) -> dict[LogKey, dict[str, Any]]:
    """What is wanted of each log."""
    selected = pl.DataFrame(list(wanted), schema=dict.fromkeys(LOG, pl.String), orient="row")
    files = {_key(row): row[FILES] for row in logs.join(selected, on=LOG, how="semi").iter_rows(named=True)}
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        rows = threads.map(partial(_ask, files=files), wanted.items())
        return dict(zip(wanted, rows, strict=True))


def _ask(item: tuple[LogKey, list[pl.Expr]], files: Mapping[LogKey, list[str]]) -> dict[str, Any]:
    (log_id, config), expressions = item
    tables = scan_tables(files[log_id, config])
    own = tables.filter(pl.col("log_id") == log_id, pl.col("config") == config)
    lazy = scanned(own, frozenset(tables.collect_schema()))
    return collect(lazy.select(expressions), files[log_id, config][0]).row(0, named=True)


def _worst_log(row: Mapping[str, Any], found: Mapping[str, Any], column: str) -> WorstLog:
    values = row[valued(column)]
    frames = (LookAt(at["frame"], at["since_start_s"], at["value"]) for at in found[f"worst {column}"])
    return WorstLog(_key(row), row[summed(column)] / values, values / row[FRAMES], tuple(frames))


def _least_covered(row: Mapping[str, Any], found: Mapping[str, Any], column: str) -> LeastCovered:
    ends = found[f"without {column}"]
    first, last = (LookAt(ends[side]["frame"], ends[side]["since_start_s"], 0.0) for side in ("first", "last"))
    return LeastCovered(_key(row), row["share"], first, last)


def _key(row: Mapping[str, Any]) -> LogKey:
    return row["log_id"], row["config"]


def chosen(logs: pl.DataFrame, keys: list[str], number: int) -> pl.DataFrame:
    """The worst groups of logs: by each quantity in turn the next worst mean, until there are so many.

    Args:
        logs: as ``logs_of`` gives them, with the columns of the keys.
        keys: names of these.
        number: of groups.
    """
    totals = [name for quantity in RANKED for name in (valued(quantity.column), summed(quantity.column))]
    groups = logs.group_by(keys, maintain_order=True).agg(pl.sum(*totals))
    orders = [_ranked(groups, quantity) for quantity in _ranked_by(logs)]
    picked: dict[int, None] = {}
    for place in range(groups.height):
        for order in orders:
            if place < len(order) and len(picked) < number:
                picked[order[place]] = None
    return groups[sorted(picked)].select(keys)


def _ranked(groups: pl.DataFrame, quantity: Quantity) -> list[int]:
    """The rows of the groups that have a mean, the worst first."""
    bad = groups.select(_mean_badness(quantity).alias("bad")).with_row_index("index")
    return bad.sort("bad", descending=True, nulls_last=True).filter(pl.col("bad").is_not_null())["index"].to_list()
