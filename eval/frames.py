"""Finds the run and the frame that the arguments of ``roadperc-view`` name: a log, a table, or a batch's dataset."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path, PurePath

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.schemas.columns import FrameMetrics, columns_of
from roadperc_stream.system.text import listed, nearest

from .dataset.keys import LOG, LogKey, config_named, log_names, settings_by_config
from .dataset.pairs import in_a_folder, runs_of_logs
from .dataset.place import DONE, Dataset, dataset_at, read_runs
from .runs import Run, collect, find_runs
from .scan import rows_of


def runs_to_show(argument: str, log: str | None, configs: Sequence[str], files: ExitStack) -> list[Run | Path]:
    """The runs that an argument names; a log needs no table.

    It is a log, a table, a folder of tables or a dataset. ``configs`` are names or settings, empty if the dataset has
    one configuration. ``files`` removes copies of tables when it closes.

    Raises:
        RoadpercError: the argument names no run.
    """
    dataset = dataset_at(argument)
    if dataset is not None:
        local = files.enter_context(in_a_folder(dataset))
        return [*_runs_of_log(replace(local, copy_of=argument), log, configs or [""])]
    if log is not None or configs:
        raise TableError(f"{argument}: is no dataset of a batch; --log and --config need one")
    path = Path(argument)
    return [path] if path.suffix == ".mcap" and path.exists() else [*find_runs([argument])]


def _runs_of_log(dataset: Dataset, name: str | None, configs: Sequence[str]) -> list[Run]:
    """The run of a log under each configuration; ``name`` is its name in the report, its file, or its ``log_id``."""
    runs = read_runs(dataset).filter(pl.col("log_id").is_not_null(), pl.col("status") == DONE)
    names = log_names(runs["log_id"].unique(maintain_order=True), runs)
    if name is None:
        raise TableError(
            f"{dataset.copy_of}: is a dataset; pass --log NAME; its logs: {listed(sorted(names.values()))}"
        )
    log_id = next((key for key, known in names.items() if known in {name, PurePath(name).stem} or key == name), None)
    if log_id is None:
        hint = f"did you mean {nearest(name, names.values(), 0.0)}?"
        raise TableError(f"{dataset.copy_of}: --log {name}: no such log in the dataset; {hint}")
    of_log = runs.filter(pl.col("log_id") == log_id)
    known = settings_by_config(of_log, of_log["config"].to_list())
    keys = [(log_id, config_named("--config", config, known)) for config in configs]
    return [*runs_of_keys(dataset, of_log, keys, names).values()]


def runs_of_keys(
    dataset: Dataset, runs: pl.DataFrame, keys: Sequence[LogKey], names: Mapping[str, str]
) -> dict[LogKey, Run]:
    """The runs of logs and configurations, from a dataset in a local folder; ``log`` is empty without a whole result.

    Raises:
        TableError: a table cannot be read.
    """
    whole = {*runs.filter(pl.col("logs") == "whole").select(LOG).iter_rows()}
    found = runs_of_logs(dataset, keys, names)
    return {key: run if key in whole else replace(run, log="") for key, run in found.items()}


def worst_frame(run: Run | Path, column: str) -> int:
    """The frame with the largest absolute value of a column, or with the lowest value if high is better.

    Raises:
        TableError: the run has no table, no such column, or no value in it.
    """
    table = run if isinstance(run, Run) else find_runs([str(run)])[0]
    rows = collect(rows_of(table), table.source_name)
    numbers = [name for name, kind in rows.schema.items() if kind.is_numeric()]
    if column not in numbers:
        hint = nearest(column, numbers, 0.0)
        raise TableError(f"{table.path}: --worst {column}: no such column of numbers; nearest: {hint}")
    lowest = getattr(columns_of(FrameMetrics).get(column), "better", "") == "high"
    value = pl.col(column).cast(pl.Float64)
    known = rows.filter(value.is_finite()).sort(value if lowest else -value.abs(), maintain_order=True)
    if known.is_empty():
        raise TableError(f"{table.path}: --worst {column}: no frame has a value")
    return int(known["frame"][0])
