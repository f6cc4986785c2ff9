"""The results of a comparison for other programs: JSON, Markdown and JUnit XML."""

from collections import Counter
from collections.abc import Iterator
from typing import Any, get_args

from ..result_files import Case, Outcome, ResultFiles, write_files
from .comparing import Comparison
from .display import metrics_table
from .summary import command, outcome, summary, values, where
from .verdicts import Mark, MarkedStatistic, Place, Verdict

_ALL_LOGS = "all logs"


def write_results(found: Comparison, files: ResultFiles, *, exact: bool) -> None:
    """Write the files for other programs; with ``exact`` also each field as a JUnit case.

    Raises:
        TargetError: a file cannot be written.
    """
    first, *lines = summary(found)
    markdown = f"Comparison: {first}", lines, [metrics_table(found)]
    write_files(files, as_json(found), markdown, "compare", list(_cases(found, exact=exact)))


def as_json(found: Comparison) -> dict[str, Any]:
    """The verdict, counts, changed settings, every judged metric with its statistics, and counts of fields."""
    changed = {line for lines in found.changes for line in lines[1:]}
    states = Counter(agreement.state for agreement in found.fields.values())
    return {
        "verdict": outcome(found),
        "counts": {mark: len(found.named(mark)) for mark in get_args(Mark)},
        "frames": found.frames,
        "logs": len(found.pairing.pairs),
        "missing_logs": len(found.pairing.missing),
        "settings": dict(line.split(" ", 1) for line in sorted(changed)),
        "metrics": {verdict.metric.name: _metric(verdict) for verdict in found.verdicts if verdict.judged},
        "fields": {state.replace(" ", "_"): states[state] for state in ("identical", "within tolerance", "differs")},
    }


def _metric(verdict: Verdict) -> dict[str, Any]:
    metric = verdict.metric
    statistics = {finding.statistic.replace(" ", "_"): _statistic(finding) for finding in verdict.findings}
    facts = {"mark": verdict.mark, "unit": metric.unit, "group": metric.group, "frames": verdict.frames}
    place = {"place": _place(verdict.place)} if verdict.place and verdict.mark == "worse" else {}
    return {**facts, "relevant": float(f"{verdict.relevant:.6g}"), **statistics, **place}


def _statistic(finding: MarkedStatistic) -> dict[str, Any]:
    known = {"base": finding.base, "new": finding.new, "difference": finding.new - finding.base, "mark": finding.mark}
    interval = vars(finding.interval) if finding.interval else {}
    return {**known, **interval, **({"log": finding.log} if finding.log else {})}


def _place(place: Place) -> dict[str, Any]:
    at = {"log": place.pair.name, "frame": place.frame, "stamp_ns": place.stamp_ns}
    return {**at, "base": place.base, "new": place.new, "command": command(place)}


def _cases(found: Comparison, *, exact: bool) -> Iterator[Case]:
    """A case for each statistic of a judged metric, for each missing run, and with ``exact`` for each field."""
    pairs = found.pairing.pairs
    every = pairs[0].name if len(pairs) == 1 else _ALL_LOGS
    for finding in (finding for verdict in found.verdicts if verdict.judged for finding in verdict.findings):
        worse, text = finding.mark == "worse", f"{finding.mark}: {values(finding)}"
        text += f"\n{where(finding.metric, finding.place)}" if worse and finding.place else ""
        result: Outcome = "failed" if worse else "passed"
        yield Case(finding.log or every, f"{finding.metric.name} {finding.statistic}", result, text)
    yield from (Case(run.name, "run", "failed", "missing in the new run") for run in found.pairing.missing)
    for name, agreement in found.fields.items() if exact else ():
        first = agreement.first
        text = f"first in frame {first.frame}: {first.base} → {first.new}" if first else agreement.state
        yield Case(first.run if first else every, f"{name} equal", "failed" if first else "passed", text)
