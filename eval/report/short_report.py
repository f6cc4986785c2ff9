"""A report: lines and tables for a terminal and Markdown, values for JSON, cases for JUnit; and the short ones."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

from ..compare.comparison import compare_runs
from ..compare.pairing import pair_runs
from ..compare.summary import summary as verdict_lines
from ..compare.verdicts import Mark
from ..findings import Found, finding_counts, report_lines
from ..frame_commands import view_command
from ..options import Rules
from ..report_columns import TRUTH
from ..results import Results
from ..runs import Run
from ..summaries import Summary
from .stages import (
    NO_TRUTH,
    Command,
    assumed_height,
    cases_of,
    judged_stages,
    latency_line,
    stage_figures,
    stage_table,
    values_of,
    worst_line,
    worst_of,
)

_MARKS: Final[tuple[Mark, ...]] = ("worse", "better")


def with_findings(report: Results, found: Found, notes: Iterable[str] = ()) -> Results:
    """The report with the findings of its runs and notes in its first lines, and the findings in its values."""
    values = {**report.values, "findings": finding_counts(found)}
    return replace(report, head=(*report_lines(found), *notes, *report.head), values=values)


def of_summaries(title: str, kind: str, summaries: Sequence[Summary], command: Command) -> Results:
    """The stages of one summary, or the worst frame of several; ``kind`` is their name in JSON."""
    judged = judged_stages(summaries)
    figures = {summary.name: stage_figures(summary, judged) for summary in summaries}
    worst = worst_of(found for of_one in figures.values() for found in of_one)
    (first, *others) = summaries
    tables = () if others else (stage_table(figures, judged),)
    shown = [worst_line(worst, command(worst.at))] if worst and worst.at else []
    times = [] if others else [latency_line(first)]
    values = {summary.name: values_of(summary, figures[summary.name], command) for summary in summaries}
    cases = tuple(case for name, found in figures.items() for case in cases_of(name, found))
    truth = any(quantity.column in summary.statistics for quantity in TRUTH for summary in summaries)
    head = () if truth else (NO_TRUTH,)
    heights = dict.fromkeys(filter(None, map(assumed_height, summaries)))
    return Results("report", title, (*head, *heights), tables, (*shown, *times), {kind: values}, cases)


def of_pair(runs: Sequence[Run], summaries: Sequence[Summary]) -> Results:
    """The verdict of a comparison of two runs of one log; the first run is the base.

    Raises:
        TableError: a table cannot be read, or the runs share no stamp.
    """
    base, new = runs
    found = compare_runs(pair_runs([base], [new], other_log=True), None, Rules())
    with_each = of_summaries(
        "Differences", "runs", summaries, lambda at: view_command(base if at.run == base.name else new, at.frame)
    )
    changed = [verdict for mark in _MARKS for verdict in found.named(mark)]
    values = {v.metric.name: {"base": v.base, "new": v.new, **vars(v.interval), "mark": v.mark} for v in changed}
    return replace(
        with_each,
        head=(f"base {base.name}, new {new.name}", *with_each.head, *verdict_lines(found)),
        tables=(),
        tail=tuple(f"{name} {latency_line(s)}" for name, s in zip(("base", "new"), summaries, strict=True)),
        values={**with_each.values, "differences": values},
    )
