"""The worst logs of a dataset, and their worst frames, which are read in a second pass."""

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Final

import polars as pl

from roadperc_stream.schemas.columns import RATIO

from ..report_columns import COVERED, RANKED, Quantity, ranked
from ..runs import collect
from ..scan import scanned, worst_frames
from .keys import LOG
from .place import scan_tables
from .reading import FILES, FRAMES, summed, valued

LogKey = tuple[str, str]
"""Log and configuration."""
Row = Mapping[str, Any]
_AT_ONCE: Final = 2


def worst_logs(logs: pl.DataFrame, number: int) -> tuple[dict[Quantity, list[Row]], dict[str, list[Row]]]:
    """The worst logs by each quantity, with their worst frames.

    Errors against truth rank the logs, or suspect quantities without truth. Logs with only perfect frames are left out.
    ``logs`` come from ``logs_of``; ``number`` limits the logs, and the frames of each log.

    Returns:
        By quantity: rows with ``LOG``, the ``mean`` of the absolute values (of the values if high is better), the
        ``share`` of frames with a value, and ``at``, the worst frames. By output: rows with ``LOG``, the ``share`` of
        frames with the output, and ``at``, the ``first`` and ``last`` frame of the longest stretch without it.

    Raises:
        TableError: a table cannot be read.
    """
    ranked = {q: (_worst(logs, q, number), worst_frames(q, number)) for q in _ranked_by(logs)}
    covered = {name: (_uncovered(logs, column, number), _longest_without(column)) for name, column in COVERED.items()}
    wanted: dict[LogKey, list[pl.Expr]] = {}
    for rows, look in (*ranked.values(), *covered.values()):
        for log_id, config in rows.select(LOG).iter_rows():
            wanted.setdefault((log_id, config), []).append(look)
    found = _read(logs, wanted)

    def with_frames(rows: pl.DataFrame, look: pl.Expr) -> list[Row]:
        return [row | {"at": found[key_of(row)][look.meta.output_name()]} for row in rows.iter_rows(named=True)]

    return (
        {q: with_frames(*ranking) for q, ranking in ranked.items() if ranking[0].height},
        {name: with_frames(*ranking) for name, ranking in covered.items() if ranking[0].height},
    )


def key_of(row: Row) -> LogKey:
    """The log and configuration of a row."""
    return row["log_id"], row["config"]


def _ranked_by(logs: pl.DataFrame) -> list[Quantity]:
    return ranked({q.column for q in RANKED if logs[valued(q.column)].sum()})


def _mean_badness(quantity: Quantity) -> pl.Expr:
    """A number that is larger for a worse log: the mean over the frames with a value; null without values."""
    mean = pl.col(summed(quantity.column)) / pl.col(valued(quantity.column))
    return pl.when(pl.col(valued(quantity.column)) > 0).then(-mean if quantity.better == "high" else mean)


def _worst(logs: pl.DataFrame, quantity: Quantity, number: int) -> pl.DataFrame:
    best = (-1.0 if quantity.unit == RATIO else -math.inf) if quantity.better == "high" else 0.0
    values = pl.col(valued(quantity.column))
    means = (pl.col(summed(quantity.column)) / values).alias("mean"), (values / pl.col(FRAMES)).alias("share")
    ranked = logs.select(*LOG, *means, _mean_badness(quantity).alias("bad")).filter(pl.col("bad") > best)
    return _each_once(ranked.sort("bad", *LOG, descending=[True, False, False]), number)


def _uncovered(logs: pl.DataFrame, column: str, number: int) -> pl.DataFrame:
    """The logs with the smallest share of frames with a value, without complete logs and disabled outputs."""
    enabled = logs.filter(pl.col(valued(column)).sum().over("config") > 0)
    ranked = enabled.with_columns((pl.col(valued(column)) / pl.col(FRAMES)).alias("share"))
    return _each_once(ranked.filter(pl.col("share") < 1).sort("share", *LOG), number)


def _each_once(ranked: pl.DataFrame, number: int) -> pl.DataFrame:
    """The first logs, each under its first configuration."""
    return ranked.unique("log_id", keep="first", maintain_order=True).head(number)


def _longest_without(column: str) -> pl.Expr:
    """A struct of the first and last frame of the longest stretch without a value, the first of equal ones."""
    without = pl.col(column).is_null()
    stretch = without.rle_id().filter(without)
    longest = stretch == stretch.mode().min()
    rows = pl.struct("frame", "since_start_s").filter(without).filter(longest)
    return pl.struct(rows.first().alias("first"), rows.last().alias("last")).alias(f"without {column}")


def _read(logs: pl.DataFrame, wanted: Mapping[LogKey, list[pl.Expr]]) -> dict[LogKey, dict[str, Any]]:
    """Read the requested expressions of each log."""
    selected = pl.DataFrame(list(wanted), schema=dict.fromkeys(LOG, pl.String), orient="row")
    files = {key_of(row): row[FILES] for row in logs.join(selected, on=LOG, how="semi").iter_rows(named=True)}
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        rows = threads.map(partial(_read_log, files=files), wanted.items())
        return dict(zip(wanted, rows, strict=True))


def _read_log(item: tuple[LogKey, list[pl.Expr]], files: Mapping[LogKey, list[str]]) -> dict[str, Any]:
    (log_id, config), expressions = item
    tables = scan_tables(files[log_id, config])
    own = tables.filter(pl.col("log_id") == log_id, pl.col("config") == config)
    lazy = scanned(own)
    return collect(lazy.select(expressions), files[log_id, config][0]).row(0, named=True)


def chosen(logs: pl.DataFrame, keys: list[str], number: int) -> pl.DataFrame:
    """The worst groups of logs: in turn the next worst mean by each quantity, up to ``number`` groups.

    ``logs`` are the result of ``logs_of`` with the columns ``keys``.
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
    """Indices of the groups with a mean, the worst first."""
    bad = groups.select(_mean_badness(quantity).alias("bad")).with_row_index("index")
    return bad.sort("bad", descending=True, nulls_last=True).filter(pl.col("bad").is_not_null())["index"].to_list()
