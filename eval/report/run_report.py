"""The report on finished runs."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from roadperc_stream.errors import TableError
from roadperc_stream.output.text_table import Row, Table
from roadperc_stream.system.text import number

from ..configurations import UNKNOWN, grouped, settings_table, settings_that_differ, short_digest
from ..continued import find_joined
from ..findings import findings_of
from ..frame_commands import view_command
from ..options import ReportOptions
from ..report_columns import SKEW, legend, listed, name_columns, percent, short_names
from ..results import Results
from ..runs import Run
from ..summaries import Summary, summarise_group, summarise_run
from ..trajectory.trajectory import in_short
from .by_expression import slices_of_runs
from .full_tables import LISTED, accuracy, full_tables, latency, missing_outputs, worst_frames
from .short_report import of_pair, of_summaries, with_findings
from .stages import RUNS_SHOWN, rows_tables

RUNS_LISTED: Final = 40
"""Most rows of the table of runs with ``--full``."""
_HAS_TRUE_POSES: Final = "turn_error_deg"
_MORE: Final = "pass --full for all tables, --by EXPRESSION for slices"


class RunReport:
    """The report on runs; a table that cannot be read, and a column that does not exist, raise ``TableError``."""

    def __init__(self, names: Sequence[str], options: ReportOptions, console: Console) -> None:
        """Find the runs.

        Raises:
            TableError: an argument names no run, or no run has a frame.
        """
        found = find_joined(names)
        self._runs = [run for run in found.runs if run.frames]
        if not self._runs:
            raise TableError(f"{found.runs[0].why_empty}; expected a table with frames")
        self._notes = *found.notes, *(run.why_empty for run in found.runs if not run.frames)
        self._findings = findings_of(self._runs)
        self._options, self._columns = options, name_columns(console)

    def write_page(self, path: Path) -> None:
        """Write the page."""
        from ..html.page import write_page  # noqa: PLC0415 - only the page needs plotly

        write_page(path, self._runs)

    def short(self) -> Results:
        """The stages of a run, the differences of two runs of a log, a row for each of several, or slices."""
        return with_findings(self._short(), self._findings, self._notes)

    def full(self) -> Results:
        """All tables."""
        runs, worst = self._runs, self._options.worst
        parts = _of_one(runs[0], worst) if len(runs) == 1 else _of_several(runs, worst, self._columns)
        return with_findings(Results("report", "Report", (), tuple(parts)), self._findings, self._notes)

    def _short(self) -> Results:
        runs = self._runs
        if self._options.by:
            return slices_of_runs(runs, self._options.by)
        summaries = [summarise_run(run, 1) for run in runs]
        if len(runs) == 2 and len({summary.log_ids for summary in summaries}) == 1:
            with suppress(TableError):  # runs without a common frame get a row each
                return of_pair(runs, summaries)
        named = {run.name: run for run in runs}
        found = of_summaries("Report", "runs", summaries, lambda at: view_command(named[at.run], at.frame))
        if len(runs) == 1:
            (summary,) = summaries
            extent_s = f"{number(summary.frames, 'frame')}{in_segments(summary)}, {summary.span_s:.2f} s"
            head = (f"{identity(summary)}, {extent_s}", *found.head)
            line, errors = _trajectory(runs[0], summary)
            values = {"runs": {summary.name: found.values["runs"][summary.name] | errors}}
            return replace(found, head=head, tail=(*line, *found.tail, _MORE), values=values)
        shown = f"; the worst {RUNS_SHOWN}:" if len(runs) > RUNS_SHOWN else ""
        frames = sum(summary.frames for summary in summaries)
        head = (f"{contents(summaries)}, {frames} frames{shown}", *found.head, *_settings(runs))
        names = short_names([run.name for run in runs], self._columns)
        tables = rows_tables("Run", [replace(s, name=names[s.name]) for s in summaries], of_runs=True)
        return replace(found, head=head, tables=tables, tail=(*found.tail, _MORE))


def _settings(runs: Sequence[Run]) -> Iterator[str]:
    """A line with the values of the settings that differ."""
    values, notes = settings_that_differ({run.name: run for run in runs})
    texts = [f"{key} {'/'.join(dict.fromkeys(of_runs.values()))}" for key, of_runs in values.items()]
    if texts or notes:
        yield f"settings that differ: {listed((*texts, *notes))}"


def _trajectory(run: Run, summary: Summary) -> tuple[tuple[str, ...], dict[str, Any]]:
    """The line and the values of the errors of a run's path; both are empty without true poses."""
    return in_short(run) if _HAS_TRUE_POSES in summary.statistics else ((), {})


def _of_one(run: Run, worst: int) -> Iterator[str | Table]:
    summary = summarise_run(run, worst)
    yield from (identity(summary), extent(summary), inputs(summary), *_trajectory(run, summary)[0])
    yield from (*full_tables([summary]), worst_frames([summary]))


def _of_several(found: Sequence[Run], worst: int, columns: int) -> Iterator[str | Table]:
    """Statistics by configuration, then by run; runs of two configurations are never pooled."""
    names = short_names([run.name for run in found], columns)
    grouped_runs = grouped([replace(run, name=names[run.name]) for run in found])
    groups = [summarise_group(group, worst) for group in grouped_runs]
    together = [summary for _, summary in groups]
    runs = [summary for summaries, _ in groups for summary in summaries]
    rows = runs[:RUNS_LISTED]
    yield contents(runs)
    yield settings_table({group.name: group.example for group in grouped_runs})
    yield runs_table(rows, tuple(legend(names)))
    for summary in together[:LISTED]:
        yield from ("", *([f"{summary.name}:"] if len(groups) > 1 else []), extent(summary), inputs(summary))
        if summary.rank_error:
            yield precision(summary)
    yield from (*full_tables(together), worst_frames(together), *rows_tables("Run", runs))
    if len(runs) > len(groups):
        yield from tables_by_run(runs)
    if len(runs) > len(rows):
        yield f"listed: the first {len(rows)} of {len(runs)} runs"
    each_time = f"at most {LISTED} of {{}} per row, those with the worst p95"
    if len(groups) > LISTED:
        yield f"by configuration: {each_time.format(len(groups))}"
    if len(runs) > max(len(groups), LISTED):
        yield f"by run: {each_time.format(len(runs))}"


def identity(summary: Summary) -> str:
    """Log, configuration and version of a run."""
    config, version = short_digest(summary.configs[0]), summary.versions[0] or UNKNOWN
    return f"{summary.name}: log {listed(summary.log_ids)}, configuration {config}, version {version}"


def contents(summaries: Sequence[Summary]) -> str:
    """Numbers of runs, logs, configurations and versions."""
    kinds = {"log": "log_ids", "configuration": "configs", "version": "versions"}
    names = {kind: {name for summary in summaries for name in getattr(summary, of)} for kind, of in kinds.items()}
    counts = ", ".join(number(len(found), kind) for kind, found in names.items())
    return f"{sum(summary.runs for summary in summaries)} runs: {counts}"


def extent(summary: Summary) -> str:
    """Number of frames, time span, rate and longest gap."""
    frames = f"{number(summary.frames, 'frame')}{in_segments(summary)}"
    if summary.rate_hz is None:
        return frames
    rate = f"{summary.rate_hz:.1f} frames/s, longest gap {summary.longest_gap_s:.2f} s"
    return f"{frames} over {summary.span_s:.2f} s, {rate}"


def in_segments(summary: Summary) -> str:
    """The number of segments, if a table has several."""
    return f" in {summary.segments} segments" if summary.segments > summary.runs else ""


def inputs(summary: Summary) -> str:
    """Roles without a message, and the skew between the sensors' stamps."""
    if summary.incomplete:
        roles = ", ".join(f"{role} {percent(n / summary.frames)} %" for role, n in summary.missing.most_common())
        text = f"{percent(summary.incomplete / summary.frames)} % of the frames lack a message: {roles}"
    else:
        text = "no message missing in any frame"
    skew = summary.statistics.get(SKEW.column)
    return text if skew is None else f"{text}; sync skew median {skew.median:.1f} ms, p95 {skew.p95:.1f} ms"


def precision(summary: Summary) -> str:
    """The rank error of thinned quantiles."""
    error = 100 * summary.rank_error
    return (
        f"quantiles over all {summary.frames} frames are within {error:.2f} % in rank, "
        f"those of absolute values within {2 * error:.2f} %"
    )


def runs_table(summaries: Sequence[Summary], notes: tuple[str, ...]) -> Table:
    """A row per run: log, configuration, extent, and the version if they differ."""
    versions = len({summary.versions for summary in summaries}) > 1
    headers = ("log id", "config", *(["version"] if versions else []), "frames", "s", "frames/s")
    return Table("Run", headers, tuple(_run(s, versions) for s in summaries), notes, label_columns=15)


def _run(summary: Summary, with_version: bool) -> Row:
    version = [summary.versions[0] or "unknown"] if with_version else []
    extent = (str(summary.frames), f"{summary.span_s:.2f}", f"{summary.rate_hz:.1f}" if summary.rate_hz else "")
    return (summary.name, listed(summary.log_ids, 1), short_digest(summary.configs[0]), *version, *extent)


def tables_by_run(summaries: Sequence[Summary]) -> Iterator[Table]:
    """Missing outputs that differ between runs, accuracy and latency, each with a line per run."""
    for table in (missing_outputs(summaries, vary_only=True), accuracy(summaries), latency(summaries)):
        yield replace(table, title=f"{table.title} by run", notes=())
