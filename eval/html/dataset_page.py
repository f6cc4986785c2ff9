"""The page over a batch's dataset, with pages of its failed and its worst logs in a folder beside it."""

from collections.abc import Mapping, Sequence
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
from ..quantities import Quantity
from .page import rendered, write_page
from .pictures import shown
from .verdict import single_sentence, size, stage_table

PAGES: Final = 10
"""Most pages of logs: failed ones first, then the worst."""


BadLogs = dict[LogKey, tuple[Quantity, float, float]]
"""By log: the quantity with the worst mean, the mean, and its size as a multiple of the relevant effect."""


def write_dataset_page(target: Path, dataset: Dataset) -> None:
    """Write the page to a ``.html`` or ``.htm`` file, and the pages of logs to the folder ``NAME_logs``.

    Raises:
        TableError: there are no tables, or one cannot be read.
        TargetError: a page cannot be written, or has another suffix.
        StorageError: the store cannot be read.
    """
    require_suffix(target, ".html", ".htm")
    with in_a_folder(dataset) as local:
        if not (files := metrics_files(local)):
            raise TableError(f"{dataset.address}: {NO_TABLES}")
        _write(target, local, files, dataset.address)


def _write(target: Path, local: Dataset, files: Sequence[str], address: str) -> None:
    runs = read_runs(local)
    found = group_frames(files, runs, [])
    configs = in_order_of_runs(found.logs["config"].unique(maintain_order=True).to_list(), runs)
    names = log_names(found.logs["log_id"].unique(maintain_order=True), runs)
    summaries = summaries_of(found, names, configs)
    failed = runs.filter(pl.col("status") != DONE).sort("status", "path", "config")
    worst = worst_of(found.logs, PAGES)
    folder = target.with_name(f"{target.stem}_logs")
    folder.mkdir(parents=True, exist_ok=True)
    failed_links = _write_failed(folder, failed.head(PAGES))
    links = {}
    for place, (key, run) in enumerate(runs_of_logs(local, list(worst)[: PAGES - len(failed_links)], names).items(), 1):
        write_page(folder / f"worst_{place}.html", [run])
        links[_name(key, names)] = f"{folder.name}/worst_{place}.html"
    mark: Mark = "worse" if failed.height else "better"
    verdicts = [(mark, f"{failed.height} of {number(runs.height, 'run')} failed")] if runs.height else []
    for summary in summaries:
        mark, text = single_sentence(summary)
        verdicts.append((mark, f"{summary.name}: {text}" if len(summaries) > 1 else text))
    settings = settings_that_differ(settings_by_config(runs, configs))
    lost, bad = _failed_table(failed), _worst_table(worst, names)
    tables = [(stage_table(summaries), {}), (settings, {}), (lost, failed_links), (bad, links)]
    _render(target, address, verdicts, tables)


def _render(
    target: Path, title: str, verdicts: Sequence[tuple[Mark, str]], tables: Sequence[tuple[TextTable, dict[str, str]]]
) -> None:
    text = rendered("dataset.html", title=title, verdicts=verdicts, tables=tables, by_header=by_header)
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


def _name(key: LogKey, names: Mapping[str, str]) -> str:
    return f"{names[key[0]]} {key[1]}"


def _failed_table(failed: pl.DataFrame) -> TextTable:
    columns = failed.select("path", "config", "status", "error").iter_rows()
    rows = [row(f"{path} {config}", status, error or "no reason given") for path, config, status, error in columns]
    return TextTable("Failed logs", ("status", "error"), tuple(rows), last_is_text=True)


def _worst_table(worst: BadLogs, names: Mapping[str, str]) -> TextTable:
    rows = [row(_name(key, names), shown(mean, q), f"{times:.0f}", q.name) for key, (q, mean, times) in worst.items()]
    notes = ("mean of the absolute error over the log, and its distance from a perfect value in relevant effects",)
    return TextTable("Worst logs", ("mean", "relevant effects", "metric"), tuple(rows), notes, last_is_text=True)


def _write_failed(folder: Path, failed: pl.DataFrame) -> dict[str, str]:
    """Write a page with the facts of each failed log; the address of each from the dataset's page."""
    links = {}
    for place, item in enumerate(failed.iter_rows(named=True), 1):
        facts = [row(name, str(value)) for name, value in item.items() if value not in (None, [], "")]
        table = TextTable("Run", ("value",), tuple(facts), last_is_text=True)
        said = f"{item['status']}: {item['error'] or 'no reason given'}"
        _render(folder / f"failed_{place}.html", item["path"], [("worse", said)], [(table, {})])
        links[f"{item['path']} {item['config']}"] = f"{folder.name}/failed_{place}.html"
    return links
