"""The findings of runs: lines for people, and counts for other programs."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import polars as pl

from roadperc_stream.model.finding import Finding
from roadperc_stream.system.text import number

from .dataset.place import DONE
from .runs import Run

Found = Mapping[str, Sequence[Finding]]
"""The findings of each run by its name."""


def findings_of(runs: Iterable[Run]) -> Found:
    """The findings that the tables of runs record, by name of the run."""
    return {run.name: run.findings or () for run in runs}


def findings_of_dataset(runs: pl.DataFrame) -> Found:
    """The findings in a dataset's list of runs, by path and configuration."""
    done = runs.filter(pl.col("status") == DONE).select("path", "config", pl.col("findings").fill_null([]))
    return {
        f"{path} ({config})": [Finding(code, text) for code, _, text in (line.partition(": ") for line in lines)]
        for path, config, lines in done.iter_rows()
    }


def finding_lines(found: Found) -> list[str]:
    """A line for each finding of one run; of several runs, a line for each kind, with their number and an example."""
    if len(found) == 1:
        return [str(finding) for findings in found.values() for finding in findings]
    return [
        f"{code} in {one['runs']} of {number(len(found), 'run')}, such as {one['run']}: {one['example']}"
        for code, one in finding_counts(found).items()
    ]


def report_lines(found: Found) -> list[str]:
    """The first lines of a report."""
    return [f"finding {line}" for line in finding_lines(found)]


def finding_counts(found: Found) -> dict[str, dict[str, Any]]:
    """By code, the most frequent first: the number of runs with the finding, and the name and text of the first one."""
    kinds: dict[str, dict[str, str]] = {}
    for name, findings in found.items():
        for finding in findings:
            kinds.setdefault(finding.code, {}).setdefault(name, finding.text)
    ordered = sorted(kinds.items(), key=lambda item: (-len(item[1]), item[0]))
    return {
        code: {"runs": len(texts), "of": len(found), "run": name, "example": texts[name]}
        for code, texts in ordered
        for name in [next(iter(texts))]
    }
