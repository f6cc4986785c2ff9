"""The page over a batch's dataset, with pages of its failed and its worst logs in a folder beside it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.output.text_table import Table
from roadperc_stream.system.files import require_suffix, write_whole
from roadperc_stream.system.text import number

from ..compare.verdicts import Mark
from ..dataset.keys import LOG, LogKey
from ..dataset.pairs import runs_of_logs
from ..dataset.place import DONE, Dataset
from ..findings import findings_of_dataset, report_lines
from ..report.dataset_lines import reason_of_failure, settings_of_dataset
from ..report.grouping import configuration_columns, grouped_frames
from ..report.sources import FrameSource, load
from ..report.stages import stages_of
from ..report.summaries import summarise
from ..report.worst_logs import WorstLogs
from ..report_columns import Quantity, with_unit
from .page import render, write_page
from .verdict import single_sentence, size

PAGES: Final = 10
"""Most pages of logs: failed ones first, then the worst."""
_FACTS: Final = (
    *("names", "config", "config_digest", "settings", "options", "recover", "frames", "dropped", "unreadable"),
    *("warnings", "size_bytes", "seconds", "peak_memory_mb", "attempts", "worker", "version", "code", "libraries"),
)
"""Columns of the list of runs on the page of a failed log."""


@dataclass(frozen=True)
class BadLog:
    """A log under a configuration, a mean of its errors, and the mean's size as a multiple of the relevant effect."""

    name: str
    key: LogKey
    quantity: Quantity
    mean: float
    size: float


def write_dataset_page(target: Path, dataset: Dataset, source: FrameSource, runs: pl.DataFrame) -> None:
    """Write the page to a ``.html`` or ``.htm`` file, and the pages of logs to the folder ``NAME_logs``.

    The dataset is in a local folder; ``source`` are its frames and ``runs`` its list of runs.

    Raises:
        TableError: a table cannot be read.
        TargetError: a page cannot be written, or has another suffix.
    """
    require_suffix(target, ".html", ".htm")
    frames = load(source)
    logs = WorstLogs(frames, PAGES)
    (summaries,) = summarise(frames, [grouped_frames(frames, configuration_columns(frames))], also=logs.add)
    failed = runs.filter(pl.col("status") != DONE).sort("status", "path", "config")
    folder = target.with_name(f"{target.stem}_logs")
    folder.mkdir(parents=True, exist_ok=True)
    several = len({*runs["config"], *frames.runs["config"]}) > 1
    failed_links = _write_failed(folder, failed.head(PAGES), several)
    worst = worst_of(logs, several)
    drawn = worst[: PAGES - len(failed_links)]
    found = runs_of_logs(dataset, [log.key for log in drawn], {log.key[0]: log.name for log in drawn})
    links = {}
    for place, log in enumerate(drawn, 1):
        write_page(folder / f"worst_{place}.html", [found[log.key]])
        links[log.name] = f"{folder.name}/worst_{place}.html"
    mark: Mark = "worse" if failed.height else "better"
    verdicts: list[tuple[Mark, str]] = [("worse", line) for line in report_lines(findings_of_dataset(runs))]
    verdicts += [(mark, f"{failed.height} of {number(runs.height, 'run')} failed")] if runs.height else []
    for summary in summaries:
        mark, text = single_sentence(summary)
        verdicts.append((mark, f"{summary.name}: {text}" if len(summaries) > 1 else text))
    tables = [
        (settings_of_dataset(frames, runs), {}),
        (_failed_table(failed, several), failed_links),
        (_worst_table(worst), links),
    ]
    write_whole(target, render([dataset.name], verdicts, tables, stages=stages_of(summaries)))


def worst_of(logs: WorstLogs, several: bool) -> list[BadLog]:
    """The worst logs over all quantities, each once, the worst first, with means above the relevant effects."""
    named = logs.frames.runs.select("log", *LOG).rows()
    found = [
        BadLog(_name(name, config, several), (log_id, config), quantity, log.mean, size(log.mean, quantity))
        for quantity, ranked in logs.by_quantity.items()
        for log in ranked
        for name, log_id, config in [named[log.run]]
    ]
    largest: dict[LogKey, BadLog] = {}
    for log in sorted((log for log in found if log.size > 1), key=lambda log: -log.size):
        largest.setdefault(log.key, log)
    return list(largest.values())[:PAGES]


def _name(log: str, config: str, several: bool) -> str:
    """The name of a log, with the configuration if there are several."""
    return f"{log} {config}" if several else log


def _failed_table(failed: pl.DataFrame, several: bool) -> Table:
    rows = [
        (_name(item["path"], item["config"], several), item["status"], reason_of_failure(item["path"], item["error"]))
        for item in failed.iter_rows(named=True)
    ]
    return Table("Failed logs", ("status", "error"), tuple(rows), last_is_text=True)


def _worst_table(worst: Sequence[BadLog]) -> Table:
    rows = [(log.name, with_unit(log.mean, log.quantity), f"{log.size:.0f}", log.quantity.name) for log in worst]
    notes = ("mean of the absolute values over the log, and its distance from a perfect value in relevant effects",)
    return Table("Worst logs", ("mean", "relevant effects", "metric"), rows, notes, last_is_text=True)


def _write_failed(folder: Path, failed: pl.DataFrame, several: bool) -> dict[str, str]:
    """Write a page with the facts of each failed log; the address of each from the dataset's page."""
    links = {}
    for place, item in enumerate(failed.iter_rows(named=True), 1):
        facts = [(name, _fact(item[name])) for name in _FACTS if item.get(name)]
        table = Table("Run", ("value",), tuple(facts), last_is_text=True)
        said = f"{item['status']}: {reason_of_failure(item['path'], item['error'])}"
        write_whole(folder / f"failed_{place}.html", render([item["path"]], [("worse", said)], [], stages=table))
        links[_name(item["path"], item["config"], several)] = f"{folder.name}/failed_{place}.html"
    return links


def _fact(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)
