"""Summaries of a dataset's frames by group; if there are too many groups, of the worst ones."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.system.time import NS_PER_S

from ..expressions import as_key, key_name
from ..report_columns import COUNTS, NUMBERS, TEXTS
from ..summaries import EXACT_FRAMES, POINTS, Figures, Summary
from .keys import LOG, Grouping, Key, group_name, grouping, in_order
from .place import DONE, RUN_COLUMNS, scan_tables, without_file
from .reading import FILES, GAP_NS, SEGMENTS, SPAN_NS, batches, ledger, logs_of, rows_of_tables
from .worst import chosen

MOST_GROUPS: Final = 40
"""Most groups with statistics; if there are more groups of whole logs, only the worst ones have statistics."""
_FEWEST_POINTS: Final = 256
_AT_ONCE: Final = 2
_POOLED: Final = (*LOG, "missing", "reasons", *TEXTS, *COUNTS, *(quantity.column for quantity in NUMBERS))


def require_few(groups: int, by: Sequence[str]) -> None:
    """Check the number of groups whose frames are not those of whole logs.

    Raises:
        TableError: there are too many.
    """
    if groups > MOST_GROUPS:
        raise TableError(
            f"--by {','.join(by)}: has more than {MOST_GROUPS} different values in the frames; "
            'expected fewer, as in lane_left_status or "floor(distance_m / 10) * 10"'
        )


def _add_batch(pools: dict[Key, Figures], batch: pl.DataFrame, by: Grouping, threads: Executor) -> bool:
    """Add a batch with the columns of the keys; False if there are too many groups of whole logs.

    Raises:
        TableError: a column of the tables has too many values.
    """
    keys = [key_name(name) for name in by.columns]
    groups: dict[Key, pl.DataFrame] = {batch.select(keys).row(0) if keys else (): batch}
    if keys and batch.select(keys).unique().height > 1:
        groups = batch.select(*keys, *_POOLED).partition_by(keys, as_dict=True, maintain_order=True)
    count = len({*pools, *groups})
    if by.of_whole_logs and count > MOST_GROUPS:
        return False
    require_few(count, by.columns)
    for key, frames in groups.items():
        pools.setdefault(key, Figures(EXACT_FRAMES)).add(frames, threads=threads)
    return True


@dataclass(frozen=True)
class GroupedFrames:
    """The logs and groups of a dataset.

    ``logs`` come from ``logs_of``, with the columns of the keys if the groups consist of whole logs. ``groups`` is the
    number of all groups; ``pools`` has those with statistics.
    """

    logs: pl.DataFrame
    by: Grouping
    pools: Mapping[Key, Figures]
    groups: int


def group_frames(files: Sequence[str], runs: pl.DataFrame, asked: Sequence[str]) -> GroupedFrames:
    """Read the tables of a dataset.

    ``files`` are at least one, for an address a pattern. Without ``asked`` columns the groups are configurations, and
    versions if they differ.

    Raises:
        TableError: a table cannot be read, a frame appears twice, or a column does not exist or has too many values.
    """
    known = runs.filter(pl.col("log_id").is_not_null())
    versions = known.filter(pl.col("status") == DONE)["version"].unique().to_list()
    by = grouping(
        asked or (["config", "version"] if len(versions) > 1 else ["config"]),
        scan_tables(files).collect_schema().names(),
    )
    found = _grouped(files, known, by)
    if asked:
        return found
    keep = [k for k, name in enumerate(by.columns) if found.logs[key_name(name)].n_unique() > 1]
    pools = {tuple(key[k] for k in keep): pool for key, pool in found.pools.items()}
    return replace(found, by=grouping([by.columns[k] for k in keep], ()), pools=pools)


def _grouped(files: Sequence[str], known: pl.DataFrame, by: Grouping) -> GroupedFrames:
    run_keys = known.select(*LOG, *(as_key(name, RUN_COLUMNS) for name in by.of_runs))
    rows = rows_of_tables(files, by)
    replaced = without_file(known).select(LOG)
    if replaced.height:
        rows = rows.join(replaced.lazy(), on=LOG, how="anti", maintain_order="left")
    logs, pools = _read(rows, files, by, run_keys)
    if by.of_whole_logs:
        own = (pl.col(name).alias(key_name(name)) for name in by.columns if name not in by.of_runs)
        logs = logs.with_columns(own).join(run_keys, on=LOG, how="left", maintain_order="left")
    if pools is not None:
        return GroupedFrames(logs, by, pools, len(pools))
    keys = [key_name(name) for name in by.columns]
    only = logs.join(chosen(logs, keys, MOST_GROUPS), on=keys, how="semi", nulls_equal=True)
    in_files = only[FILES].explode().unique(maintain_order=True).to_list()
    again = rows_of_tables(in_files, by).join(only.select(LOG).lazy(), on=LOG, how="semi", maintain_order="left")
    return GroupedFrames(logs, by, _read(again, in_files, by, run_keys)[1] or {}, logs.select(keys).n_unique())


def _read(
    rows: pl.LazyFrame, files: Sequence[str], by: Grouping, run_keys: pl.DataFrame
) -> tuple[pl.DataFrame, dict[Key, Figures] | None]:
    """The logs of metrics tables, and the groups by key; None if there are more than ``MOST_GROUPS``.

    ``run_keys`` has the columns ``LOG`` and the keys from the list of runs, a row for each log and configuration.
    """
    ledgers: list[pl.DataFrame] = []
    pools: dict[Key, Figures] | None = {}
    read = 0
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        for batch in batches(rows, files):
            ledgers.append(ledger(batch))
            if pools is None:
                continue
            keys = batch.select(LOG).join(run_keys, on=LOG, how="left", maintain_order="left").drop(LOG)
            read += batch.height
            if not _add_batch(pools, batch.hstack(keys) if by.of_runs else batch, by, threads):
                pools = None
            elif read > EXACT_FRAMES:
                for pool in pools.values():
                    pool.limit(max(_FEWEST_POINTS, min(POINTS, POINTS * 8 // len(pools))))
    if not ledgers:
        raise TableError("no log to report: other logs have replaced all files, and these have no tables")
    return logs_of(ledgers), pools


def summaries_of(found: GroupedFrames, log_names: Mapping[str, str], configs: Sequence[str]) -> list[Summary]:
    """A summary of each group with statistics, in the order of the keys (``in_order``)."""
    columns, extents = found.by.columns, _extents(found)
    return [
        replace(found.pools[key].summary(group_name(key, columns, log_names)), **extents.get(key, {}))
        for key in in_order(found.pools, columns, configs, log_names)
    ]


def _extents(found: GroupedFrames) -> dict[Key, dict[str, Any]]:
    """Number, span and longest gap of each group's segments; empty if the groups are not of whole logs."""
    if not found.by.of_whole_logs:
        return {}
    keys = [pl.col(key_name(name)) for name in found.by.columns] or [pl.lit(0)]
    sums = found.logs.group_by(keys).agg(
        pl.sum(SEGMENTS).alias("segments"),
        (pl.sum(SPAN_NS) / NS_PER_S).alias("span_s"),
        (pl.max(GAP_NS).fill_null(0) / NS_PER_S).alias("longest_gap_s"),
    )
    names = sums.columns[-3:]
    return {row[: len(found.by.columns)]: dict(zip(names, row[-3:], strict=True)) for row in sums.iter_rows()}
