"""Checks runs against absolute limits, and writes the results for people and for other programs."""

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, get_args

from roadperc_stream.errors import RegressionError, TableError
from roadperc_stream.output.terminal import console_for, print_lines
from roadperc_stream.output.text_table import TextTable, row
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import number

from .continued import find_joined
from .criteria import DEFAULT_CRITERIA, read_criteria
from .dataset.pairs import all_runs, in_a_folder
from .dataset.place import DONE, Dataset, dataset_at, read_runs
from .judging import Result, judge, unit_of
from .machine import Case, Outcome, write_json, write_junit, write_markdown
from .quantities import listed, percent
from .reference_criteria import write_criteria
from .runs import Run

_LISTED: Final = 5
"""Failed criteria with a line for the worst frame; the others are named."""
_BY_SEVERITY: Final[tuple[Outcome, ...]] = ("failed", "error", "passed", "skipped")


@dataclass(frozen=True)
class FailedLog:
    """A log of a batch without a result, and the reason."""

    path: str
    reason: str


@dataclass(frozen=True)
class Check:
    """The results of all criteria, and the logs of a batch that have none."""

    criteria: Path
    runs: tuple[Run, ...]
    results: tuple[Result, ...]
    failed_logs: tuple[FailedLog, ...]

    @property
    def by_title(self) -> dict[str, list[Result]]:
        """The results of each criterion, the failed ones first."""
        order = sorted(self.results, key=lambda result: _BY_SEVERITY.index(result.outcome))
        titles = dict.fromkeys(result.criterion.title for result in self.results)
        return {title: [result for result in order if result.criterion.title == title] for title in titles}

    @property
    def counts(self) -> dict[Outcome, int]:
        """The number of criteria by outcome; a criterion with several logs has that of its worst one."""
        found = Counter(results[0].outcome for results in self.by_title.values())
        return {outcome: found[outcome] for outcome in get_args(Outcome) if outcome != "error"} | {
            "error": len(self.failed_logs)
        }

    @property
    def verdict(self) -> Outcome:
        """The worst outcome; skipped only if every criterion is."""
        return next(outcome for outcome in _BY_SEVERITY if self.counts[outcome])


def check(arguments: argparse.Namespace) -> None:
    """Judge the criteria over runs and print the results; with ``--init`` write criteria instead.

    Raises:
        RegressionError: a criterion failed.
        RoadpercError: a file cannot be read or written, a log of a batch has no result, or all criteria are skipped.
    """
    with ExitStack() as stack:
        runs, failed_logs = _found(arguments.runs, stack)
        if arguments.init is not None:
            count = write_criteria(arguments.init, runs, force=arguments.force)
            print_lines(console_for(sys.stdout), f"{arguments.init}: {number(count, 'metric')} with limits")
            return
        path = arguments.criteria or DEFAULT_CRITERIA
        found = Check(path, runs, tuple(judge(read_criteria(path), runs, path)), failed_logs)
    _write(found, arguments)
    with optional_output():
        print_lines(console_for(sys.stdout), *_lines(found), unbroken=True)
    if found.verdict == "failed":
        raise RegressionError(f"failed: {listed(_titles(found, 'failed'))}")
    if found.verdict == "error":
        raise TableError(f"{failed_logs[0].path}: has no result: {failed_logs[0].reason}")
    if found.verdict == "skipped":
        raise TableError(f"{path}: all criteria are skipped, so nothing is checked: {found.results[0].reason}")


def _found(arguments: Sequence[str], stack: ExitStack) -> tuple[tuple[Run, ...], tuple[FailedLog, ...]]:
    """The runs with frames, and the failed logs of batches.

    Raises:
        RoadpercError: an argument names no run, or no run has a frame.
    """
    datasets = [stack.enter_context(in_a_folder(found)) for text in arguments if (found := dataset_at(text))]
    others = [text for text in arguments if dataset_at(text) is None]
    runs = [*(run for dataset in datasets for run in all_runs(dataset)), *(find_joined(others).runs if others else ())]
    filled = tuple(run for run in runs if run.frames)
    if not filled:
        raise TableError(f"{runs[0].why_empty}; expected a table with frames")
    return filled, tuple(log for dataset in datasets for log in _failed_logs(dataset))


def _failed_logs(dataset: Dataset) -> Iterator[FailedLog]:
    rows = read_runs(dataset).select("path", "status", "error")
    for path, status, reason in rows.iter_rows():
        if status != DONE:
            yield FailedLog(path, reason or status)


def _titles(found: Check, outcome: Outcome) -> list[str]:
    return [title for title, results in found.by_title.items() if results[0].outcome == outcome]


def _lines(found: Check) -> Iterator[str]:
    """The verdict, a line for each criterion that is not passed, and the counts."""
    failed, frames = _titles(found, "failed"), sum(run.frames for run in found.runs)
    where = f"{number(frames, 'frame')} of {number(len(found.runs), 'run')}"
    criteria = "default criteria" if found.criteria == DEFAULT_CRITERIA else str(found.criteria)
    yield f"check: {found.verdict}, {where}, {criteria}"
    for title in failed[:_LISTED]:
        yield from _failure(title, found.by_title[title])
    if len(failed) > _LISTED:
        yield f"failed   also {listed(failed[_LISTED:])}"
    for log in found.failed_logs[:_LISTED]:
        yield f"error    {log.path} has no result: {log.reason}"
    skipped: dict[str, list[str]] = {}
    for title in _titles(found, "skipped"):
        skipped.setdefault(found.by_title[title][0].reason, []).append(title)
    yield from (f"skipped  {listed(titles, len(titles))}: {reason}" for reason, titles in skipped.items())
    yield ", ".join(f"{count} {outcome}" for outcome, count in found.counts.items() if count or outcome != "error")


def _failure(title: str, results: Sequence[Result]) -> Iterator[str]:
    failed = [result for result in results if result.outcome == "failed"]
    first = max(failed, key=_excess)
    logs = f" in {len(failed)} of {len(results)} logs, worst {first.log}" if first.criterion.per_log else ""
    yield f"failed   {title}{logs}: {first.text}"
    if first.worst is not None:
        yield f"         worst frame: {first.worst.command}"


def _excess(result: Result) -> float:
    """How far the value is beyond its bound; negative if only the coverage is too low."""
    most, least, value = result.criterion.most, result.criterion.least, result.value
    if value is None:
        return float("inf")
    return value - most if most is not None else (least or 0.0) - value


def _write(found: Check, arguments: argparse.Namespace) -> None:
    """Write the files of ``--json``, ``--markdown`` and ``--junit``."""
    if arguments.json is not None:
        write_json(arguments.json, _as_json(found))
    if arguments.markdown is not None:
        write_markdown(arguments.markdown, f"Check: {found.verdict}", list(_lines(found))[1:], [_table(found)])
    if arguments.junit is not None:
        cases = [Case(result.log, result.criterion.title, result.outcome, _body(result)) for result in found.results]
        logs = [Case(log.path, "replay", "error", log.reason) for log in found.failed_logs]
        write_junit(arguments.junit, "roadperc-check", [*cases, *logs])


def _body(result: Result) -> str:
    place = result.worst
    return result.text if place is None else f"{result.text}\nworst frame {place.frame} of {place.log}: {place.command}"


def _as_json(found: Check) -> dict[str, Any]:
    criteria = {}
    for title, results in found.by_title.items():
        per_log = results[0].criterion.per_log
        logs = {result.log: _values(result) for result in results}
        criteria[title] = {"outcome": results[0].outcome, "logs": logs} if per_log else _values(results[0])
    return {
        "verdict": found.verdict,
        "counts": found.counts,
        "runs": len(found.runs),
        "frames": sum(run.frames for run in found.runs),
        "criteria": criteria,
        "failed_logs": {log.path: log.reason for log in found.failed_logs},
    }


def _values(result: Result) -> dict[str, Any]:
    values: dict[str, Any] = {
        "outcome": result.outcome,
        "value": result.value,
        "coverage": result.coverage,
        "frames": result.frames,
    }
    if result.reason:
        values["reason"] = result.reason
    if result.worst is not None:
        values["worst"] = vars(result.worst)
    return values


def _table(found: Check) -> TextTable:
    rows = [
        row(
            result.criterion.title,
            result.outcome,
            result.log,
            "" if result.value is None else f"{result.value:.4g}{unit_of(result.criterion)}",
            result.criterion.bound,
            f"{percent(result.coverage)} %",
            str(result.frames),
        )
        for results in found.by_title.values()
        for result in results
    ]
    return TextTable("Criterion", ("result", "log", "value", "bound", "coverage", "frames"), tuple(rows))
