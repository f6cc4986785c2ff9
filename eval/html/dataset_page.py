"""The page over a batch's dataset, with pages of its failed and its worst logs in a folder beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.output.text_table import TextTable, by_header, row
from roadperc_stream.system.files import completing, require_suffix
from roadperc_stream.system.text import number

from ..comparison.verdicts import Mark
from ..dataset.groups import group_frames, summaries_of
from ..dataset.keys import in_order_of_runs, log_names, settings_by_config
from ..dataset.pairs import in_a_folder, runs_of_logs
from ..dataset.place import DONE, NO_TABLES, Dataset, metrics_files, read_runs
from ..dataset.report import settings_that_differ
from ..dataset.worst import LogKey, key_of, worst_logs
from ..frame_commands import view_dataset_command
from ..quantities import Quantity
from .page import rendered, write_page
from .pictures import shown
from .verdict import single_sentence, size, stage_table

PAGES: Final = 10
"""Most pages of logs: failed ones first, then the worst."""


@dataclass(frozen=True)
class BadLog:
    """A log and configuration, and the quantity whose mean is the largest multiple of its relevant effect."""

    key: LogKey
    name: str
    quantity: Quantity
    mean: float
    size: float


def write_dataset_page(target: Path, dataset: Dataset) -> None:
    """Write the page to a ``.html`` or ``.htm`` file, and the pages of logs to the folder ``NAME_logs``.

    Raises:
        TableError: there are no tables, or one cannot be read.
        TargetError: a page cannot be written, or has another suffix.
        StorageError: the store cannot be read.
    """
    require_suffix(target, ".html", ".htm")
    with in_a_folder(dataset) as local:
        _write(target, local, dataset.address)


def _write(target: Path, local: Dataset, address: str) -> None:
    runs, files = read_runs(local), metrics_files(local)
    if not files:
        raise TableError(f"{address}: {NO_TABLES}")
    found = group_frames(files, runs, [])
    configs = in_order_of_runs(found.logs["config"].unique(maintain_order=True).to_list(), runs)
    names = log_names(found.logs["log_id"].unique(maintain_order=True), runs)
    summaries = summaries_of(found, names, configs)
    failed = runs.filter(pl.col("status") != DONE).sort("status", "path", "config")
    worst = worst_of(found.logs, names, PAGES)
    folder = target.with_name(f"{target.stem}_logs")
    failed_links = _write_failed(folder, failed.head(PAGES))
    shown_logs = worst[: PAGES - len(failed_links)]
    links = _write_worst(folder, shown_logs, local, names, address)
    verdicts: list[tuple[Mark, str]] = [_statuses(runs, failed.height)]
    for summary in summaries:
        mark, text = single_sentence(summary)
        verdicts.append((mark, f"{summary.name}: {text}" if len(summaries) > 1 else text))
    settings = settings_that_differ(settings_by_config(runs, configs))
    tables = [
        (stage_table(summaries), {}),
        (settings, {}),
        (_failed_table(failed), failed_links),
        (_worst(worst), links),
    ]
    text = rendered("dataset.html", title=address, verdicts=verdicts, tables=tables, by_header=by_header)
    with completing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")


def worst_of(logs: pl.DataFrame, names: Mapping[str, str], most: int) -> list[BadLog]:
    """The worst logs over all quantities, each once, with a mean above the relevant effect of its quantity.

    Raises:
        TableError: a table cannot be read.
    """
    by_quantity, _ = worst_logs(logs, most)
    several = logs["config"].n_unique() > 1
    found = [
        BadLog(key, f"{names[key[0]]} {key[1]}" if several else names[key[0]], quantity, mean, size(mean, quantity))
        for quantity, rows in by_quantity.items()
        for key, mean in ((key_of(item), item["mean"]) for item in rows)
    ]
    each: dict[LogKey, BadLog] = {}
    for log in sorted((log for log in found if log.size > 1), key=lambda log: -log.size):
        each.setdefault(log.key, log)
    return list(each.values())[:most]


def _statuses(runs: pl.DataFrame, failed: int) -> tuple[Mark, str]:
    if not runs.height:
        return "unchanged", "The status of the runs is unknown, because there is no runs.parquet"
    return ("worse" if failed else "better"), f"{failed} of {number(runs.height, 'run')} failed"


def _failed_table(failed: pl.DataFrame) -> TextTable:
    columns = failed.select("path", "config", "status", "error").iter_rows()
    rows = [row(f"{path} {config}", status, error or "no reason given") for path, config, status, error in columns]
    return TextTable("Failed logs", ("status", "error"), tuple(rows), last_is_text=True)


def _worst(worst: Sequence[BadLog]) -> TextTable:
    rows = [row(log.name, shown(log.mean, log.quantity), f"{log.size:.0f}", log.quantity.name) for log in worst]
    notes = ("mean of the absolute error over the log, and its distance from a perfect value in relevant effects",)
    return TextTable("Worst logs", ("mean", "relevant effects", "metric"), tuple(rows), notes, last_is_text=True)


def _write_failed(folder: Path, failed: pl.DataFrame) -> dict[str, str]:
    """Write a page with the facts of each failed log; the address of each from the dataset's page."""
    links = {}
    for place, item in enumerate(failed.iter_rows(named=True), 1):
        facts = [row(name, str(value)) for name, value in item.items() if value not in (None, [], "")]
        table = TextTable("Run", ("value",), tuple(facts), last_is_text=True)
        said: list[tuple[Mark, str]] = [("worse", f"{item['status']}: {item['error'] or 'no reason given'}")]
        text = rendered("dataset.html", title=item["path"], verdicts=said, tables=[(table, {})], by_header=by_header)
        target = folder / f"failed_{place}.html"
        folder.mkdir(parents=True, exist_ok=True)
        with completing(target) as temporary:
            temporary.write_text(text, encoding="utf-8")
        links[f"{item['path']} {item['config']}"] = f"{folder.name}/{target.name}"
    return links


def _write_worst(
    folder: Path, worst: Sequence[BadLog], local: Dataset, names: Mapping[str, str], address: str
) -> dict[str, str]:
    """Write the page of each log; the address of each from the dataset's page."""
    runs = runs_of_logs(local, [log.key for log in worst], names)
    links = {}
    for place, log in enumerate(worst, 1):
        target = folder / f"worst_{place}.html"
        folder.mkdir(parents=True, exist_ok=True)
        log_id, config = log.key
        write_page(target, [runs[log.key]], lambda _, frame: view_dataset_command(address, log_id, frame, config))
        links[log.name] = f"{folder.name}/{target.name}"
    return links
