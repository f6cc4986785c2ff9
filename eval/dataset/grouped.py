"""The frames of a dataset by group: a summary of each, the worst groups where there are too many for all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import polars as pl

from roadperc_stream.core.time import NS_PER_S

from ..summary import Summary
from .keys import LOG, Grouping, Key, as_key, default_columns, grouping, key_name
from .naming import group_name, in_order
from .place import scan_tables
from .pools import GroupExtent, Pool
from .reading import FILES, GAP_NS, MOST_GROUPS, SEGMENTS, SPAN_NS, read_contents
from .run_rows import DONE, RUN_COLUMNS, without_file
from .worst import chosen


@dataclass(frozen=True)
class GroupedFrames:
    """What a dataset's tables hold.

    ``logs`` are those of ``TableContents``, where the keys are of whole logs with their columns. Of all ``groups``
    those in ``pools`` were summed up.
    """

    logs: pl.DataFrame
    by: Grouping
    pools: Mapping[Key, Pool]
    groups: int


def group_frames(files: Sequence[str], runs: pl.DataFrame, asked: Sequence[str]) -> GroupedFrames:
    """Read the tables of a dataset.

    Args:
        files: one at least; at an address a pattern.
        runs: the list of runs.
        asked: columns to group by; what made the tables, where they differ in that, if empty.

    Raises:
        TableError: a table cannot be read, or there is no such column.
    """
    known = runs.filter(pl.col("log_id").is_not_null())
    versions = known.filter(pl.col("status") == DONE)["version"].unique().to_list()
    by = grouping(asked or default_columns(versions), scan_tables(files).collect_schema().names())
    found = _grouped(files, known, by)
    return found if asked else _without_columns_of_one_value(found)


def _grouped(files: Sequence[str], known: pl.DataFrame, by: Grouping) -> GroupedFrames:
    run_keys = known.select(*LOG, *(as_key(name, RUN_COLUMNS[name]) for name in by.of_runs))
    gone = without_file(known).select(LOG)
    contents = read_contents(files, by, run_keys, gone)
    logs = _with_keys(contents.logs, by, run_keys)
    if contents.pools is not None:
        return GroupedFrames(logs, by, contents.pools, len(contents.pools))
    keys = [key_name(name) for name in by.columns]
    only = logs.join(chosen(logs, keys, MOST_GROUPS), on=keys, how="semi", nulls_equal=True)
    in_files = only[FILES].explode().unique(maintain_order=True).to_list()
    again = read_contents(in_files, by, run_keys, gone, only.select(LOG))
    return GroupedFrames(logs, by, again.pools or {}, logs.select(keys).n_unique())


def _without_columns_of_one_value(found: GroupedFrames) -> GroupedFrames:
    keep = [k for k, name in enumerate(found.by.columns) if found.logs[key_name(name)].n_unique() > 1]
    by = grouping([found.by.columns[k] for k in keep], ())
    return replace(found, by=by, pools={tuple(key[k] for k in keep): pool for key, pool in found.pools.items()})


def summaries_of(found: GroupedFrames, log_names: Mapping[str, str], configs: Sequence[str]) -> list[Summary]:
    """A summary of each group that was summed up, in the order of their keys.

    Args:
        found: what the tables hold.
        log_names: what each log is called.
        configs: in the order in which they were first finished.
    """
    extents = _extents(found)
    return [
        found.pools[key].summary(group_name(key, found.by.columns, log_names), extents.get(key, GroupExtent()))
        for key in in_order(found.pools, found.by.columns, configs, log_names)
    ]


def _with_keys(logs: pl.DataFrame, by: Grouping, run_keys: pl.DataFrame) -> pl.DataFrame:
    if not by.of_whole_logs:
        return logs
    own = (pl.col(name).alias(key_name(name)) for name in by.columns if name not in by.of_runs)
    return logs.with_columns(own).join(run_keys, on=LOG, how="left", maintain_order="left")


def _extents(found: GroupedFrames) -> dict[Key, GroupExtent]:
    """How long each group's logs are; nothing where groups are not of whole logs."""
    if not found.by.of_whole_logs:
        return {}
    keys = [pl.col(key_name(name)) for name in found.by.columns] or [pl.lit(0)]
    sums = found.logs.group_by(keys).agg(pl.sum(SEGMENTS), pl.sum(SPAN_NS), pl.max(GAP_NS))
    return {
        tuple(row[: len(found.by.columns)]): GroupExtent(row[-3], row[-2] / NS_PER_S, (row[-1] or 0) / NS_PER_S)
        for row in sums.iter_rows()
    }
