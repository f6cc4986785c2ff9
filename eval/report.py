"""Report over finished runs, on the terminal and as an HTML page."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

from rich.console import Console

from roadperc_stream.errors import TableError
from roadperc_stream.output.terminal import console_for, print_lines, print_parts
from roadperc_stream.output.text_table import TextRow, TextTable, row
from roadperc_stream.system.text import number

from .answers import Answer, of_pair, of_summaries, print_answer, with_findings, write_answer
from .brief import RUNS_SHOWN, rows_tables
from .configurations import UNKNOWN, grouped, settings_table, short_digest
from .continued import find_joined
from .findings import findings_of, report_lines
from .frame_commands import view_command
from .options import ReportOptions
from .quantities import SKEW, legend, listed, name_columns, percent, short_names
from .result_files import ResultFiles
from .runs import Run
from .sections import LISTED, accuracy, latency, missing_outputs, sections, worst_frames
from .slices import slices_of_runs
from .summaries import Summary, summarise_group, summarise_run
from .trajectory import in_short

RUNS_LISTED: Final = 40
"""Most rows of the table of runs with ``--full``."""
_HAS_TRUE_POSES: Final = "turn_error_deg"
_MORE: Final = "pass --full for all tables, --by EXPRESSION for slices"


def print_report(names: Sequence[str], options: ReportOptions, files: ResultFiles) -> None:
    """Print the figures of finished runs, and write the page and the files for other programs.

    Raises:
        TableError: an argument names no run, no run has a frame, or a column does not exist.
        TargetError: a file cannot be written.
    """
    found = find_joined(names)
    filled = [item for item in found.runs if item.frames]
    if not filled:
        raise TableError(f"{found.runs[0].why_empty}; expected a table with frames")
    if options.html is not None:
        from .html.page import write_page  # noqa: PLC0415 - only the page needs plotly

        write_page(options.html, filled)  # first, because the reader of the text may close the pipe
    answer = None if options.full and not files.paths else _answer(filled, options.by)
    findings = findings_of(filled)
    if answer is not None:
        write_answer(with_findings(answer, findings), files)
    console = console_for(sys.stdout)
    empty = (item.why_empty for item in found.runs if not item.frames)
    print_lines(console, *report_lines(findings), *found.notes, *empty, unbroken=True)
    if answer is not None and not options.full:
        print_answer(console, answer)
    elif len(filled) == 1:
        summary = summarise_run(filled[0], options.worst)
        print_lines(console, identity(summary), extent(summary), inputs(summary), *_trajectory(filled[0], summary)[0])
        print_parts(console, *sections([summary]), worst_frames([summary]))
    else:
        _print_several(console, filled, options.worst)
    if options.html is not None:
        print_lines(console, "", f"page   {options.html}", unbroken=True)


def _answer(runs: Sequence[Run], by: Sequence[str]) -> Answer:
    """The short report."""
    if by:
        return slices_of_runs(runs, by)
    summaries = [summarise_run(run, 1) for run in runs]
    if len(runs) == 2 and len({summary.log_ids for summary in summaries}) == 1:
        with suppress(TableError):  # runs without a common frame get a row each
            return of_pair(runs, summaries)
    named = {run.name: run for run in runs}
    answer = of_summaries("Report", "runs", summaries, lambda at: view_command(named[at.run], at.frame))
    if len(runs) == 1:
        (summary,) = summaries
        extent_s = f"{number(summary.frames, 'frame')}{in_segments(summary)}, {summary.span_s:.2f} s"
        head = (f"{identity(summary)}, {extent_s}", *answer.head)
        line, errors = _trajectory(runs[0], summary)
        values = {"runs": {summary.name: answer.values["runs"][summary.name] | errors}}
        return replace(answer, head=head, tail=(*line, *answer.tail, _MORE), values=values)
    shown = f"; the worst {RUNS_SHOWN}:" if len(runs) > RUNS_SHOWN else ""
    head = (f"{contents(summaries)}, {sum(summary.frames for summary in summaries)} frames{shown}", *answer.head)
    names = short_names([run.name for run in runs], name_columns(console_for(sys.stdout)))
    tables = rows_tables("Run", [replace(s, name=names[s.name]) for s in summaries], of_runs=True)
    return replace(answer, head=(*head, *_settings(runs)), tables=tables, tail=(*answer.tail, _MORE))


def _settings(runs: Sequence[Run]) -> Iterator[str]:
    """A line with the values of the settings that differ."""
    table = settings_table({run.name: run for run in runs})
    texts = [f"{item.label} {'/'.join(dict.fromkeys(value for (value,) in item.cells))}" for item in table.rows]
    if texts or table.notes:
        yield f"settings that differ: {listed((*texts, *table.notes))}"


def _trajectory(run: Run, summary: Summary) -> tuple[tuple[str, ...], dict[str, Any]]:
    """The line and the values of the errors of a run's path; both are empty without true poses."""
    return in_short(run) if _HAS_TRUE_POSES in summary.statistics else ((), {})


def _print_several(console: Console, found: Sequence[Run], worst: int) -> None:
    """Print statistics by configuration, then by run; runs of two configurations are never pooled."""
    names = short_names([run.name for run in found], name_columns(console))
    grouped_runs = grouped([replace(run, name=names[run.name]) for run in found])
    settings = settings_table({group.name: group.example for group in grouped_runs})
    groups = [summarise_group(group, worst) for group in grouped_runs]
    together = [summary for _, summary in groups]
    runs = [summary for summaries, _ in groups for summary in summaries]
    rows = runs[:RUNS_LISTED]
    print_lines(console, contents(runs))
    print_parts(console, settings, runs_table(rows, tuple(legend(names))))
    for summary in together[:LISTED]:
        name = [f"{summary.name}:"] if len(groups) > 1 else []
        print_lines(console, "", *name, extent(summary), inputs(summary))
        if summary.rank_error:
            print_lines(console, precision(summary))
    print_parts(console, *sections(together), worst_frames(together), *rows_tables("Run", runs))
    if len(runs) > len(groups):
        print_parts(console, *tables_by_run(runs))
    if len(runs) > len(rows):
        print_lines(console, f"listed: the first {len(rows)} of {len(runs)} runs")
    each_time = f"at most {LISTED} of {{}} per row, those with the worst p95"
    if len(groups) > LISTED:
        print_lines(console, f"by configuration: {each_time.format(len(groups))}")
    if len(runs) > max(len(groups), LISTED):
        print_lines(console, f"by run: {each_time.format(len(runs))}")


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


def runs_table(summaries: Sequence[Summary], notes: tuple[str, ...]) -> TextTable:
    """A row per run: log, configuration, extent, and the version if they differ."""
    versions = len({summary.versions for summary in summaries}) > 1
    headers = ("log id", "config", *(["version"] if versions else []), "frames", "s", "frames/s")
    return TextTable("Run", headers, tuple(_run(s, versions) for s in summaries), notes, label_columns=15)


def _run(summary: Summary, with_version: bool) -> TextRow:
    version = [summary.versions[0] or "unknown"] if with_version else []
    extent = (str(summary.frames), f"{summary.span_s:.2f}", f"{summary.rate_hz:.1f}" if summary.rate_hz else "")
    return row(summary.name, listed(summary.log_ids, 1), short_digest(summary.configs[0]), *version, *extent)


def tables_by_run(summaries: Sequence[Summary]) -> Iterator[TextTable]:
    """Missing outputs that differ between runs, accuracy and latency, each with a line per run."""
    missing = missing_outputs(summaries)
    vary = tuple(item for item in missing.rows if len({cells[-1:] for cells in item.cells}) > 1)
    for table in (replace(missing, rows=vary), accuracy(summaries), latency(summaries)):
        yield replace(table, title=f"{table.title} by run", notes=())
