"""The runs of a dataset: those of all configurations, and those of two to compare each log with itself."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import gettempdir
from typing import Any, Final

import polars as pl

from roadperc_stream.batch.location import Location
from roadperc_stream.errors import TableError
from roadperc_stream.system.files import TABLE_SUFFIX, scratch_folder

from ..configurations import Settings
from ..runs import Run, open_run
from .keys import LOG, LogKey, config_named, in_order_of_runs, log_names, settings_by_config, two_configs
from .place import FILE, NO_TABLES, RUNS, Dataset, metrics_files, read_runs, without_file
from .reading import metrics_tables, reading_files, require_named

_AT_ONCE: Final = 16
"""Files fetched at the same time; files are small, so most of the time is latency."""
_ROWS: Final = "rows"


@contextmanager
def in_a_folder(dataset: Dataset) -> Iterator[Dataset]:
    """A dataset in a local folder; for an address a temporary copy of its lists of runs and its tables.

    Raises:
        TableError: the dataset has no tables.
        StorageError: the store cannot be read.
    """
    if dataset.folder is not None:
        yield dataset
        return
    store = Location(dataset.address)
    folders = "metrics", "objects", "runs"
    names = [f"{folder}/{name}" for folder in folders for name in store.at(folder).files(TABLE_SUFFIX)]
    if not names:
        raise TableError(f"{dataset.address}: {NO_TABLES}")
    place = Path(gettempdir(), "roadperc-compare")
    with scratch_folder(place) as folder, ThreadPoolExecutor(_AT_ONCE) as threads:
        list(threads.map(lambda name: store.at(name).fetch(folder / name), names))
        if (runs := store.at(RUNS).read()) is not None:
            (folder / RUNS).write_bytes(runs)
        yield Dataset(str(folder), dataset.address)


def runs_of_configs(dataset: Dataset, names: tuple[str | None, str | None]) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    """The base runs and the new runs, one for each log, from a dataset in a local folder.

    Raises:
        TableError: ``names`` do not identify two configurations, or a table cannot be read.
    """
    configs, found, logs = _contents(dataset)
    base, new = two_configs(names, configs)
    return tuple(_runs(dataset, found, base, logs)), tuple(_runs(dataset, found, new, logs))


def runs_of_config(dataset: Dataset, option: str, name: str | None) -> tuple[Run, ...]:
    """The runs of one configuration of a dataset in a local folder; without a ``name`` of the only one.

    Raises:
        TableError: the name of ``option`` does not identify a configuration, or a table cannot be read.
    """
    configs, found, logs = _contents(dataset)
    return tuple(_runs(dataset, found, config_named(option, name or "", configs), logs))


def all_runs(dataset: Dataset) -> tuple[Run, ...]:
    """The runs of all configurations of a dataset in a local folder; several add the configuration to the names.

    Raises:
        TableError: a table cannot be read.
    """
    configs, found, logs = _contents(dataset)
    every = [(config, run) for config in configs for run in _runs(dataset, found, config, logs)]
    return tuple(run if len(configs) == 1 else replace(run, name=f"{run.name} {config}") for config, run in every)


def _contents(dataset: Dataset) -> tuple[dict[str, Settings | None], pl.DataFrame, dict[str, str]]:
    """The configurations, the number of rows of each log and configuration in each file, and the names of logs."""
    files = metrics_files(dataset)
    if not files:
        raise TableError(f"{dataset.address}: {NO_TABLES}")
    runs, found = read_runs(dataset), _row_counts(files)
    found = found.join(without_file(runs), on=LOG, how="anti", maintain_order="left")
    present = in_order_of_runs(found["config"].unique(maintain_order=True).to_list(), runs)
    return settings_by_config(runs, present), found, log_names(found["log_id"].unique(maintain_order=True), runs)


def runs_of_logs(dataset: Dataset, keys: Sequence[LogKey], names: Mapping[str, str]) -> dict[LogKey, Run]:
    """The runs of logs and configurations, from a dataset in a local folder; ``names`` are those of the logs.

    Raises:
        TableError: a table cannot be read.
    """
    found = _row_counts(metrics_files(dataset))
    return {key: next(_runs(dataset, found.filter(pl.col("log_id") == key[0]), key[1], names)) for key in keys}


def _row_counts(files: Sequence[str]) -> pl.DataFrame:
    """The number of rows of each log and configuration in each file."""
    tables, _ = metrics_tables(files)
    counted = tables.select(*LOG, FILE).group_by(*LOG, FILE).agg(pl.len().alias(_ROWS)).sort(*LOG, FILE)
    with reading_files(files):
        found = counted.collect(engine="streaming")
    require_named(found)
    return found


def _runs(dataset: Dataset, found: pl.DataFrame, config: str, names: Mapping[str, str]) -> Iterator[Run]:
    of_config = found.filter(pl.col("config") == config)
    for (log_id,), rows in of_config.group_by("log_id", maintain_order=True):
        by_file = tuple(_run(dataset, row, names[str(log_id)]) for row in rows.iter_rows(named=True))
        frames = sum(run.frames for run in by_file)
        yield replace(by_file[0], frames=frames, joined=by_file if len(by_file) > 1 else ())


def _run(dataset: Dataset, row: Mapping[str, Any], name: str) -> Run:
    """The rows of a log in one file."""
    log_id, config, count = row["log_id"], row["config"], row[_ROWS]
    run = open_run(Path(row[FILE]), name)
    within = None if count == run.rows else (log_id, config)
    named = dataset.copy_of or dataset.address, config
    return replace(run, log_id=log_id, frames=count, rows=count, within=within, dataset=named)
