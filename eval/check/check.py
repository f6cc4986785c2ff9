"""Checks runs against absolute limits, and writes the results for people and for other programs."""

import math
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, get_args

from roadperc_stream.errors import RegressionError, TableError
from roadperc_stream.output.terminal import console_for, print_lines
from roadperc_stream.output.text_table import Table
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import listed, number

from ..continued import find_joined
from ..criteria import DEFAULT_CRITERIA, read_criteria
from ..dataset.pairs import all_runs, in_a_folder
from ..dataset.place import DONE, dataset_at, read_runs
from ..results import Case, Outcome, ResultFiles, Results
from ..runs import Run
from .judging import Result, judge
from .reference_criteria import write_criteria

_LISTED: Final = 5
"""Failed criteria with a line for the worst frame; the others are named."""
_BY_SEVERITY: Final[tuple[Outcome, ...]] = ("failed", "error", "passed", "skipped")


@dataclass(frozen=True)
class Check:
    """The results of all criteria, and the logs of a batch without a result: path and reason."""

    criteria: Path
    runs: tuple[Run, ...]
    results: tuple[Result, ...]
    failed_logs: tuple[tuple[str, str], ...]

    @cached_property
    def by_title(self) -> dict[str, list[Result]]:
        """The results of each criterion, the failed ones first."""
        found: dict[str, list[Result]] = {result.criterion.title: [] for result in self.results}
        for result in sorted(self.results, key=lambda result: _BY_SEVERITY.index(result.outcome)):
            found[result.criterion.title].append(result)
        return found

    @property
    def counts(self) -> dict[Outcome, int]:
        """The number of criteria by outcome; a criterion with several logs has that of its worst one."""
        found = Counter(results[0].outcome for results in self.by_title.values())
        return {outcome: found[outcome] for outcome in get_args(Outcome)} | {"error": len(self.failed_logs)}

    @property
    def verdict(self) -> Outcome:
        """The worst outcome; skipped only if every criterion is."""
        return next(outcome for outcome in _BY_SEVERITY if self.counts[outcome])


def init_criteria(names: Sequence[str], path: Path, *, force: bool) -> None:
    """Write criteria with the limits that runs reach.

    Raises:
        RoadpercError: a run cannot be read, or the file cannot be written.
    """
    with ExitStack() as stack:
        count = write_criteria(path, _found(names, stack)[0], force=force)
    print_lines(console_for(sys.stdout), f"{path}: {number(count, 'metric')} with limits")


def check(names: Sequence[str], path: Path, files: ResultFiles) -> None:
    """Judge the criteria of the file ``path`` over runs, and print and write the results.

    Raises:
        RegressionError: a criterion failed.
        RoadpercError: a file cannot be read or written, a log of a batch has no result, or all criteria are skipped.
    """
    with ExitStack() as stack:
        runs, failed_logs = _found(names, stack)
        found = Check(path, runs, tuple(judge(read_criteria(path), runs, path)), failed_logs)
    first, *lines = _lines(found)
    title, cases = f"Check: {found.verdict}", list(_cases(found))
    Results("check", title, lines, [_table(found)], values=_as_json(found), cases=cases).write(files)
    with optional_output():
        print_lines(console_for(sys.stdout), first, *lines, unbroken=True)
    if found.verdict == "failed":
        raise RegressionError(f"failed: {listed(_titles(found, 'failed'))}")
    if found.verdict == "error":
        raise TableError(": has no result: ".join(failed_logs[0]))
    if found.verdict == "skipped":
        raise TableError(f"{path}: all criteria are skipped, so nothing is checked: {found.results[0].reason}")


def _found(names: Sequence[str], stack: ExitStack) -> tuple[tuple[Run, ...], tuple[tuple[str, str], ...]]:
    """The runs with frames, and the path and the reason of each failed log of a batch.

    Raises:
        RoadpercError: an argument names no run, or no run has a frame.
    """
    datasets = [stack.enter_context(in_a_folder(found)) for text in names if (found := dataset_at(text))]
    others = [text for text in names if dataset_at(text) is None]
    runs = [*(run for dataset in datasets for run in all_runs(dataset)), *(find_joined(others).runs if others else ())]
    filled = tuple(run for run in runs if run.frames)
    if not filled:
        raise TableError(f"{runs[0].why_empty}; expected a table with frames")
    listed_logs = [row for found in datasets for row in read_runs(found).select("path", "status", "error").iter_rows()]
    return filled, tuple((path, reason or status) for path, status, reason in listed_logs if status != DONE)


def _titles(found: Check, outcome: Outcome) -> list[str]:
    return [title for title, results in found.by_title.items() if results[0].outcome == outcome]


def _lines(found: Check) -> Iterator[str]:
    """The verdict, a line for each criterion that fails, the others by outcome, and the counts."""
    failed, frames = _titles(found, "failed"), sum(run.frames for run in found.runs)
    where = f"{number(frames, 'frame')} of {number(len(found.runs), 'run')}"
    criteria = "default criteria" if found.criteria == DEFAULT_CRITERIA else str(found.criteria)
    yield f"check: {found.verdict}, {where}, {criteria}"
    for title in failed[:_LISTED]:
        yield from _failure(title, found.by_title[title])
    if len(failed) > _LISTED:
        yield f"failed   also {listed(failed[_LISTED:])}"
    yield from (f"error    {path} has no result: {reason}" for path, reason in found.failed_logs[:_LISTED])
    if passed := _titles(found, "passed"):
        yield f"passed   {listed(passed)}"
    skipped: dict[str, list[str]] = {}
    for title in _titles(found, "skipped"):
        skipped.setdefault(found.by_title[title][0].reason, []).append(title)
    yield from (f"skipped  {listed(titles, len(titles))}: {reason}" for reason, titles in skipped.items())
    yield ", ".join(f"{count} {outcome}" for outcome, count in found.counts.items() if count or outcome != "error")


def _failure(title: str, results: Sequence[Result]) -> Iterator[str]:
    failed = [result for result in results if result.outcome == "failed"]
    sign = 1 if failed[0].criterion.least is None else -1
    first = max(failed, key=lambda result: math.inf if result.value is None else sign * result.value)
    logs = f" in {len(failed)} of {len(results)} logs, worst {first.log}" if first.criterion.per_log else ""
    yield f"failed   {title}{logs}: {first.text}"
    if first.worst is not None:
        yield f"         worst frame: {first.worst.command}"


def _cases(found: Check) -> Iterator[Case]:
    """A case for each result; GitLab counts only the first case of each name, so names are unique."""
    for result in found.results:
        title, place = result.criterion.title, result.worst
        name = f"{title}, {result.log}" if result.criterion.per_log else title
        worst = f"\nworst frame {place.frame} of {place.log}: {place.command}" if place else ""
        yield Case(result.log, name, result.outcome, result.text + worst)
    yield from (Case(path, f"replay of {path}", "error", reason) for path, reason in found.failed_logs)


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
        "failed_logs": dict(found.failed_logs),
    }


def _values(result: Result) -> dict[str, Any]:
    values = {name: getattr(result, name) for name in ("outcome", "value", "coverage", "frames")}
    reason = {"reason": result.reason} if result.reason else {}
    return values | reason | ({"worst": vars(result.worst)} if result.worst else {})


def _table(found: Check) -> Table:
    rows = [
        (result.criterion.title, result.outcome, result.log, result.text, str(result.frames))
        for results in found.by_title.values()
        for result in results
    ]
    return Table("Criterion", ("result", "log", "value and bound", "frames"), tuple(rows))
