"""The page over a batch's dataset, with pages of its failed and its worst logs in a folder beside it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.output.text_table import Table
from roadperc_stream.system.files import completing, require_suffix
from roadperc_stream.system.text import number

from ..compare.verdicts import Mark
from ..dataset.pairs import in_a_folder, runs_of_logs
from ..dataset.place import DONE, Dataset
from ..dataset.summed import SummedDataset
from ..dataset.worst import LogKey, key_of, worst_logs
from ..findings import findings_of_dataset, report_lines
from ..report.stages import stages_of
from ..report_columns import Quantity
from .page import Links, render, write_page
from .pictures import shown
from .verdict import single_sentence, size

PAGES: Final = 10
"""Most pages of logs: failed ones first, then the worst."""
_FACTS: Final = (
    *("names", "config", "config_digest", "settings", "options", "recover", "frames", "dropped", "unreadable"),
    *("warnings", "size_bytes", "seconds", "peak_memory_mb", "attempts", "worker", "version", "code", "libraries"),
)
"""Columns of the list of runs on the page of a failed log."""


BadLogs = dict[LogKey, tuple[Quantity, float, float]]
"""By log: the quantity with the worst mean, the mean, and its size as a multiple of the relevant effect."""


def write_dataset_page(target: Path, dataset: Dataset) -> None:
    """Write the page to a ``.html`` or ``.htm`` file, and the pages of logs to the folder ``NAME_logs``.

    Raises:
        TableError: a table cannot be read.
        TargetError: a page cannot be written, or has another suffix.
        StorageError: the store cannot be read.
    """
    require_suffix(target, ".html", ".htm")
    with in_a_folder(dataset) as local:
        _write(target, local, dataset.address)


def _write(target: Path, local: Dataset, address: str) -> None:
    found = SummedDataset(local, ())
    runs, names, summaries = found.runs, found.names, found.summaries
    failed = runs.filter(pl.col("status") != DONE).sort("status", "path", "config")
    worst = worst_of(found.logs, PAGES)
    folder = target.with_name(f"{target.stem}_logs")
    folder.mkdir(parents=True, exist_ok=True)
    several = len({*runs["config"], *found.configs}) > 1
    failed_links = _write_failed(folder, failed.head(PAGES), several)
    links = {}
    for place, (key, run) in enumerate(runs_of_logs(local, list(worst)[: PAGES - len(failed_links)], names).items(), 1):
        write_page(folder / f"worst_{place}.html", [run])
        links[_name(names[key[0]], key[1], several)] = f"{folder.name}/worst_{place}.html"
    mark: Mark = "worse" if failed.height else "better"
    verdicts: list[tuple[Mark, str]] = [("worse", line) for line in report_lines(findings_of_dataset(runs))]
    verdicts += [(mark, f"{failed.height} of {number(runs.height, 'run')} failed")] if runs.height else []
    for summary in summaries:
        mark, text = single_sentence(summary)
        verdicts.append((mark, f"{summary.name}: {text}" if len(summaries) > 1 else text))
    lost, bad = _failed_table(failed, several), _worst_table(worst, names, several)
    _save(target, address, verdicts, stages_of(summaries), [(found.settings, {}), (lost, failed_links), (bad, links)])


def _save(
    target: Path,
    title: str,
    verdicts: Sequence[tuple[Mark, str]],
    stages: Table,
    tables: Sequence[tuple[Table, Links]] = (),
) -> None:
    text = render([title], verdicts, tables, stages=stages)
    with completing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")


def worst_of(logs: pl.DataFrame, most: int) -> BadLogs:
    """The worst logs over all quantities, the worst first, with means above the relevant effects.

    Raises:
        TableError: a table cannot be read.
    """
    rankings = worst_logs(logs, most)[0].items()
    found = [(key_of(row), (q, row["mean"], size(row["mean"], q))) for q, rows in rankings for row in rows]
    largest_last = sorted((item for item in found if item[1][2] > 1), key=lambda item: item[1][2])
    return dict(sorted(dict(largest_last).items(), key=lambda item: -item[1][2])[:most])


def _name(log: str, config: str, several: bool) -> str:
    """The name of a log, with the configuration if there are several."""
    return f"{log} {config}" if several else log


def _reason(failed: Mapping[str, str | None]) -> str:
    return (failed["error"] or "no reason given").removeprefix(f"{failed['path']}: ")


def _failed_table(failed: pl.DataFrame, several: bool) -> Table:
    rows = [
        (_name(item["path"], item["config"], several), item["status"], _reason(item))
        for item in failed.iter_rows(named=True)
    ]
    return Table("Failed logs", ("status", "error"), tuple(rows), last_is_text=True)


def _worst_table(worst: BadLogs, names: Mapping[str, str], several: bool) -> Table:
    rows = [
        (_name(names[log_id], config, several), shown(mean, q), f"{times:.0f}", q.name)
        for (log_id, config), (q, mean, times) in worst.items()
    ]
    notes = ("mean of the absolute values over the log, and its distance from a perfect value in relevant effects",)
    return Table("Worst logs", ("mean", "relevant effects", "metric"), tuple(rows), notes, last_is_text=True)


def _write_failed(folder: Path, failed: pl.DataFrame, several: bool) -> dict[str, str]:
    """Write a page with the facts of each failed log; the address of each from the dataset's page."""
    links = {}
    for place, item in enumerate(failed.iter_rows(named=True), 1):
        facts = [(name, _fact(item[name])) for name in _FACTS if item.get(name)]
        table = Table("Run", ("value",), tuple(facts), last_is_text=True)
        said = f"{item['status']}: {_reason(item)}"
        _save(folder / f"failed_{place}.html", item["path"], [("worse", said)], table)
        links[_name(item["path"], item["config"], several)] = f"{folder.name}/failed_{place}.html"
    return links


def _fact(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)
