"""``roadperc-report``: the figures of runs, of slices of them, or of a batch's dataset."""

import math
import sys
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final

import polars as pl
from rich.console import Console

from roadperc_stream.errors import TableError
from roadperc_stream.output.terminal import console_for, print_lines
from roadperc_stream.output.text_table import Table
from roadperc_stream.system.text import listed, number

from ..compare.comparison import compare_runs
from ..compare.pairing import pair_runs
from ..compare.summary import summary as verdict_lines
from ..compare.verdicts import Mark
from ..configurations import UNKNOWN, grouped, settings_table, settings_that_differ, short_digest
from ..continued import find_joined
from ..dataset.keys import LOG
from ..dataset.pairs import in_a_folder
from ..dataset.place import Dataset, dataset_at, metrics_files, read_runs
from ..findings import Found, finding_counts, findings_of, findings_of_dataset, report_lines
from ..frame_commands import view_command, view_dataset_command
from ..objects.figures import tallies
from ..objects.tables import object_tables
from ..options import ReportOptions, Rules
from ..report_columns import (
    HINDSIGHT,
    SKEW,
    Quantity,
    judged_errors,
    legend,
    name_columns,
    percent,
    short_names,
    with_unit,
)
from ..results import ResultFiles, Results
from ..runs import Run
from ..trajectory.trajectory import in_short
from .dataset_lines import (
    FAILED_LISTED,
    contents,
    least_covered_table,
    log_paths,
    log_time,
    not_listed,
    settings_of_dataset,
    statuses,
    worst_logs_table,
)
from .full_tables import LISTED, accuracy, full_tables, latency, missing_outputs, worst_frames
from .grouping import configuration_columns, grouped_frames
from .hindsight import hindsight_table
from .objects import object_slices, of_objects
from .sources import Frames, FrameSource, load, source_of_dataset, source_of_runs
from .stages import (
    BY_HINDSIGHT,
    COLUMNS,
    NO_TRUTH,
    RUNS_SHOWN,
    TRUE_POSES,
    assumed_height,
    cases_of,
    judged_stages,
    latency_line,
    rows_tables,
    stage_figures,
    stage_table,
    values_of,
    worst_line,
    worst_of,
)
from .summaries import Groups, Summary, WorstFrame, frames_in_segments, groups_of_runs, summarise
from .worst_logs import LeastCovered, WorstLog, WorstLogs

_ROWS_LISTED: Final = 40
"""Most rows of the table of runs or groups with ``--full``."""
_FEW: Final = 3
"""Failed logs and worst logs in the short report of a dataset."""
_GROUP_COLUMNS: Final = 22
"""Least width of a group's name."""
_MORE: Final = "pass --full for all tables, --by EXPRESSION for slices"
_MARKS: Final[tuple[Mark, ...]] = ("worse", "better")


@dataclass(frozen=True)
class Subject:
    """What is reported on: the ``runs``, or the ``dataset`` in a local folder with its list of runs (``listed``).

    ``findings`` are those of the runs, and ``notes`` are lines on them. ``columns`` is the width of a name.
    """

    source: FrameSource
    findings: Found
    notes: Sequence[str]
    columns: int
    runs: Sequence[Run] = ()
    dataset: Dataset | None = None
    listed: pl.DataFrame = field(default_factory=pl.DataFrame)

    def command(self, at: WorstFrame, config: str = "") -> str:
        """The command that shows a frame."""
        if self.dataset is not None:
            return view_dataset_command(self.dataset.name, at.run, at.frame, config)
        return view_command(next(run for run in self.runs if run.name == at.run), at.frame)


def report(names: Sequence[str], options: ReportOptions, files: ResultFiles) -> None:
    """Print the figures of runs or of one dataset, and write the page and the files for other programs.

    Raises:
        RoadpercError: an argument names no run, no run has a frame, a column does not exist, or a file cannot be read
            or written.
    """
    console, dataset = console_for(sys.stdout), dataset_at(names[0])
    with ExitStack() as stack:
        if dataset is None:
            subject = _of_runs(names, name_columns(console))
        else:
            local = stack.enter_context(in_a_folder(dataset))
            subject = _of_dataset(local, max(name_columns(console), _GROUP_COLUMNS), console)
        if options.html is not None:
            _write_page(options.html, subject)  # first, because the reader of the text may close the pipe
        if files.paths or not options.full:
            short = _short(subject, options)
            short.write(files)
        (_full(subject, options) if options.full else short).print(console)
    if options.html is not None:
        print_lines(console, "", f"page   {options.html}", unbroken=True)


def _of_runs(names: Sequence[str], columns: int) -> Subject:
    found = find_joined(names)
    runs = [run for run in found.runs if run.frames]
    if not runs:
        raise TableError(f"{found.runs[0].why_empty}; expected a table with frames")
    notes = [*found.notes, *(run.why_empty for run in found.runs if not run.frames)]
    return Subject(source_of_runs(runs), findings_of(runs), notes, columns, runs)


def _of_dataset(dataset: Dataset, columns: int, console: Console) -> Subject:
    runs = read_runs(dataset)
    if runs.height and not metrics_files(dataset):
        print_lines(console, *statuses(runs, FAILED_LISTED), unbroken=True)
        raise TableError(f"{dataset.name}: no tables in metrics/date=.../; no log of the batch has frames")
    notes = () if runs.height else ("no runs.parquet: failed logs are unknown",)
    return Subject(source_of_dataset(dataset, runs), findings_of_dataset(runs), notes, columns, (), dataset, runs)


def _write_page(path: Path, subject: Subject) -> None:
    """Write the page."""
    if subject.dataset is None:
        from ..html.page import write_page  # noqa: PLC0415 - only pages need plotly

        write_page(path, subject.runs)
    else:
        from ..html.dataset_page import write_dataset_page  # noqa: PLC0415 - only pages need plotly

        write_dataset_page(path, subject.dataset, subject.source, subject.listed)


def _short(subject: Subject, options: ReportOptions) -> Results:
    """The stages of one run or group, or a row for each of several; the verdict on two runs of a log; or slices."""
    if options.by and of_objects(options.by, subject.source):
        found = object_slices(subject.source, options.by)
        frames = load(subject.source)
        of_all = _of_objects(frames, grouped_frames(frames, ()))
        found = replace(found, tables=(*found.tables, *of_all))
    elif options.by or subject.dataset:
        found = _short_of_groups(subject, options.by)
    else:
        found = _short_of_runs(subject)
    return _with_findings(found, subject)


def _with_findings(found: Results, subject: Subject) -> Results:
    """The results below the findings and the notes; the findings are among the values, too."""
    values = {**found.values, "findings": finding_counts(subject.findings)}
    return replace(found, head=(*report_lines(subject.findings), *subject.notes, *found.head), values=values)


def _short_of_runs(subject: Subject) -> Results:
    runs, frames = subject.runs, load(subject.source)
    groups = groups_of_runs(frames, frames.runs["log"].to_list())
    (summaries,) = summarise(frames, [groups], COLUMNS)
    if len(runs) == 2 and len({summary.log_ids for summary in summaries}) == 1:
        with suppress(TableError):  # runs without a common frame get a row each
            return _of_pair(subject, summaries)
    found = _of_summaries("Report", "runs", summaries, subject.command)
    if len(runs) == 1:
        (summary,) = summaries
        head = f"{_identity(summary)}, {frames_in_segments(summary)}, {summary.span_s:.2f} s"
        line, errors = _trajectory(runs[0], summary)
        values = {"runs": {summary.name: found.values["runs"][summary.name] | errors}}
        return replace(found, head=(head, *found.head), tail=(*line, *found.tail, _MORE), values=values)
    shown = f"; the worst {RUNS_SHOWN}:" if len(runs) > RUNS_SHOWN else ""
    head = f"{_contents(summaries)}, {sum(summary.frames for summary in summaries)} frames{shown}"
    names = short_names([run.name for run in runs], subject.columns)
    tables = rows_tables("Run", [replace(s, name=names[s.name]) for s in summaries], of_runs=True)
    return replace(
        found, head=(head, *found.head, *_differing_settings(runs)), tables=tables, tail=(*found.tail, _MORE)
    )


def _short_of_groups(subject: Subject, by: Sequence[str]) -> Results:
    frames = load(subject.source, by)
    groups = grouped_frames(frames, by or configuration_columns(frames))
    worst = WorstLogs(frames, 1)
    (summaries,) = summarise(frames, [groups], COLUMNS, 0 if subject.dataset else 1, also=worst.add)
    if subject.dataset is None:
        found = _of_summaries("Slices", "slices", summaries, subject.command)
        return replace(found, head=(_sliced(frames, groups, by), *found.head), tables=rows_tables("Slice", summaries))
    found = _of_summaries("Report", "groups", summaries, lambda at: subject.command(at, at.config))
    names = _names_of_groups(groups.names, by, subject.columns)
    renamed = [replace(summary, name=names[summary.name]) for summary in summaries]
    columns = {figures.quantity.column for s in summaries for figures in stage_figures(s, judged_stages(summaries))}
    logs = _worst_logs(subject, worst, columns)
    lines = [f"worst log: {q.name} {with_unit(log['mean'], q)} on average: {log['command']}" for q, log in logs]
    lines += [latency_line(summary) for summary in summaries if len(summaries) == 1]
    return replace(
        found,
        head=(*_head(subject, frames, _FEW), *found.head),
        tables=(settings_of_dataset(frames, subject.listed), *(found.tables or rows_tables("Group", renamed))),
        tail=(*legend(names), *lines, _MORE),
        values={**found.values, "worst_logs": [log for _, log in logs]},
    )


def _worst_logs(subject: Subject, worst: WorstLogs, columns: Container[str]) -> list[tuple[Quantity, dict[str, Any]]]:
    """The worst log by each of a few quantities, with its worst frame; the largest multiple of a limit first."""
    several = worst.frames.runs["config"].n_unique() > 1
    found = [(quantity, logs[0]) for quantity, logs in worst.by_quantity.items() if quantity.column in columns]
    ordered = sorted(found, key=lambda item: -item[1].mean / (item[0].limit or math.inf))[:_FEW]
    return [
        (
            quantity,
            {
                "column": quantity.column,
                "log": (at := log.frames[0]).run,
                "mean": log.mean,
                **{name: value for name, value in vars(at).items() if name != "run"},
                "command": subject.command(at, at.config if several else ""),
            },
        )
        for quantity, log in ordered
    ]


def _of_summaries(title: str, kind: str, summaries: Sequence[Summary], command: Callable[[WorstFrame], str]) -> Results:
    """The stages of one summary, or the worst frame of several; ``kind`` is their name in JSON."""
    judged = judged_stages(summaries)
    figures = {summary.name: stage_figures(summary, judged) for summary in summaries}
    worst = worst_of(found for of_one in figures.values() for found in of_one)
    (first, *others) = summaries
    tables = () if others else (stage_table(figures, judged),)
    lines = [worst_line(worst, command(worst.at))] if worst and worst.at else []
    lines += [] if others else [latency_line(first)]
    values = {summary.name: values_of(summary, figures[summary.name], command) for summary in summaries}
    cases = [case for name, found in figures.items() for case in cases_of(name, found)]
    heights = dict.fromkeys(filter(None, map(assumed_height, summaries)))
    head = (*_kinds_of_errors(summaries), *heights)
    return Results("report", title, head, tables, lines, {kind: values}, cases)


def _kinds_of_errors(summaries: Sequence[Summary]) -> Iterator[str]:
    """A line that says which errors are no errors against truth."""
    judging = judged_errors({column for summary in summaries for column in summary.statistics})
    later = [quantity for quantity in judging if quantity in HINDSIGHT]
    if not judging:
        yield NO_TRUTH
    elif len(later) == len(judging):
        yield BY_HINDSIGHT
    elif later:
        yield f"By hindsight, against what later frames found, without truth: {listed([q.column for q in later])}"


def _of_pair(subject: Subject, summaries: Sequence[Summary]) -> Results:
    """The verdict of a comparison of two runs of one log; the first run is the base.

    Raises:
        TableError: a table cannot be read, or the runs share no stamp.
    """
    base, new = subject.runs
    found = compare_runs(pair_runs([base], [new], other_log=True), None, Rules())
    with_each = _of_summaries("Differences", "runs", summaries, subject.command)
    changed = [verdict for mark in _MARKS for verdict in found.named(mark)]
    values = {v.metric.name: {"base": v.base, "new": v.new, **vars(v.interval), "mark": v.mark} for v in changed}
    return replace(
        with_each,
        head=(f"base {base.name}, new {new.name}", *with_each.head, *verdict_lines(found)),
        tables=(),
        tail=[f"{name} {latency_line(s)}" for name, s in zip(("base", "new"), summaries, strict=True)],
        values={**with_each.values, "differences": values},
    )


def _full(subject: Subject, options: ReportOptions) -> Results:
    """All tables."""
    if options.by and of_objects(options.by, subject.source):
        return _short(subject, options)
    of_groups = options.by or subject.dataset
    found = _full_of_groups(subject, options) if of_groups else _full_of_runs(subject, options.worst)
    return _with_findings(found, subject)


def _full_of_runs(subject: Subject, worst: int) -> Results:
    """Tables by configuration, then by run; runs of two configurations are never pooled."""
    short = short_names([run.name for run in subject.runs], subject.columns)
    runs = [replace(run, name=short[run.name]) for run in subject.runs]
    frames, groups = load(source_of_runs(runs)), grouped(runs)
    group_of = {run.name: group.name for group in groups for run in group.runs}
    groupings = [
        groups_of_runs(frames, [group_of[name] for name in frames.runs["log"]]),
        groups_of_runs(frames, frames.runs["log"].to_list()),
    ]
    together, by_run = summarise(frames, groupings, worst=worst)
    tables: list[Table | str] = []
    if len(runs) == 1:
        tables += [_identity(together[0]), *_extents(together), *_trajectory(runs[0], together[0])[0]]
    else:
        tables += [_contents(by_run), settings_table({group.name: group.example for group in groups})]
        tables += [_runs_table(by_run, tuple(legend(short))), *_extents(together)]
    tables += [*full_tables(together), *_of_objects(frames, groupings[0]), *_agreement(frames), worst_frames(together)]
    if len(runs) > 1:
        tables += rows_tables("Run", by_run)
    if len(runs) > len(groups):
        tables += _tables_by_run(by_run)
    return Results("report", "Report", (), [*tables, *_left_out({"configuration": together, "run": by_run})])


def _full_of_groups(subject: Subject, options: ReportOptions) -> Results:
    """Tables of the groups, or of the configurations of a dataset, and its worst logs."""
    frames, dataset = load(subject.source, options.by), subject.dataset
    by = options.by or configuration_columns(frames)
    groups = grouped_frames(frames, by)
    worst = WorstLogs(frames, options.worst) if dataset else None
    (summaries,) = summarise(frames, [groups], worst=options.worst, also=worst.add if worst else None)
    names = _names_of_groups(groups.names, by, subject.columns)
    summaries = [replace(summary, name=names[summary.name]) for summary in summaries]
    tables: list[Table | str] = [settings_of_dataset(frames, subject.listed)] if dataset else []
    tables += [_groups_table(summaries, by, tuple(legend(names)))] if by else _extents(summaries)
    groups = replace(groups, names=[names[name] for name in groups.names])
    tables += [*full_tables(summaries), *_of_objects(frames, groups), *_agreement(frames)]
    tables += [] if dataset else [worst_frames(summaries)]
    tables += _left_out({"group": summaries})
    if worst is None:
        return Results("report", "Report", [_sliced(frames, groups, by)], tables)
    ranked: list[WorstLog | LeastCovered] = list(chain.from_iterable(worst.by_quantity.values()))
    ranked += chain.from_iterable(worst.covered.values())
    several = frames.runs["config"].n_unique() > 1
    runs = dict.fromkeys(log.run for log in ranked)
    full = {
        run: " ".join(frames.runs.row(run, named=True)[name] for name in ("log", *["config"] * several)) for run in runs
    }
    short = short_names([*full.values()], subject.columns)
    shown = {run: short[name] for run, name in full.items()}
    tables += [worst_logs_table(worst, shown), least_covered_table(worst, shown)]
    return Results("report", "Report", _head(subject, frames, FAILED_LISTED), tables, ("", *log_paths(frames, [*runs])))


def _of_objects(frames: Frames, groups: Groups) -> Iterator[Table]:
    """The tables on detections and tracks of each group, if the logs have true objects."""
    return object_tables(dict(zip(groups.names, tallies(frames, groups), strict=True)))


def _agreement(frames: Frames) -> Iterator[Table]:
    """The table on hindsight, if the log has truth."""
    if (found := hindsight_table(frames)).rows:
        yield found


def _head(subject: Subject, frames: Frames, failed: int) -> list[str]:
    """The lines on a dataset."""
    if subject.dataset is None:
        return []
    lines = statuses(subject.listed, failed), not_listed(subject.listed, frames.runs.select(LOG))
    return [contents(subject.dataset, frames), *chain.from_iterable(lines)]


def _names_of_groups(names: Sequence[str], by: Sequence[str], width: int) -> dict[str, str]:
    """Short names of groups; long names of groups by several columns are replaced by numbers."""
    if len(by) > 1 and any(len(name) > width for name in names):
        return {name: f"group {number}" for number, name in enumerate(names, 1)}
    return short_names(names, width)


def _sliced(frames: Frames, groups: Groups, by: Sequence[str]) -> str:
    return f"{number(len(frames.run), 'frame')} in {number(len(groups.names), 'slice')} by {', '.join(by)}"


def _differing_settings(runs: Sequence[Run]) -> Iterator[str]:
    """A line with the values of the settings that differ."""
    values, notes = settings_that_differ({run.name: run for run in runs})
    texts = [f"{key} {'/'.join(dict.fromkeys(of_runs.values()))}" for key, of_runs in values.items()]
    if texts or notes:
        yield f"settings that differ: {listed((*texts, *notes))}"


def _trajectory(run: Run, summary: Summary) -> tuple[tuple[str, ...], dict[str, Any]]:
    """The line and the values of the errors of a run's path; both are empty without true poses."""
    return in_short(run) if TRUE_POSES in summary.statistics else ((), {})


def _identity(summary: Summary) -> str:
    """Log, configuration and version of a run."""
    config, version = short_digest(summary.configs[0]), summary.versions[0] or UNKNOWN
    return f"{summary.name}: log {listed(summary.log_ids)}, configuration {config}, version {version}"


def _contents(summaries: Sequence[Summary]) -> str:
    """Numbers of runs, logs, configurations and versions."""
    kinds = {"log": "log_ids", "configuration": "configs", "version": "versions"}
    names = {kind: {name for summary in summaries for name in getattr(summary, of)} for kind, of in kinds.items()}
    counts = ", ".join(number(len(found), kind) for kind, found in names.items())
    return f"{sum(summary.runs for summary in summaries)} runs: {counts}"


def _extents(summaries: Sequence[Summary]) -> Iterator[str]:
    """Two lines for each group: frames, time span, rate and longest gap; and what the inputs lack."""
    for summary in summaries[:LISTED]:
        yield from ["", f"{summary.name}:"] if len(summaries) > 1 else []
        extent = frames_in_segments(summary)
        if summary.rate_hz is not None:
            rate = f"{summary.rate_hz:.1f} frames/s, longest gap {summary.longest_gap_s:.2f} s"
            extent = f"{extent} over {summary.span_s:.2f} s, {rate}"
        yield from (extent, _inputs(summary))


def _inputs(summary: Summary) -> str:
    """Roles without a message, and the skew between the sensors' stamps."""
    if summary.incomplete:
        roles = ", ".join(f"{role} {percent(n / summary.frames)} %" for role, n in summary.missing.most_common())
        text = f"{percent(summary.incomplete / summary.frames)} % of the frames lack a message: {roles}"
    else:
        text = "no message missing in any frame"
    skew = summary.statistics.get(SKEW.column)
    return text if skew is None else f"{text}; sync skew median {skew.median:.1f} ms, p95 {skew.p95:.1f} ms"


def _runs_table(summaries: Sequence[Summary], notes: tuple[str, ...]) -> Table:
    """A row per run: log, configuration, extent, and the version if they differ."""
    versions = len({summary.versions for summary in summaries}) > 1
    rows = [
        (
            s.name,
            listed(s.log_ids, 1),
            short_digest(s.configs[0]),
            *([s.versions[0] or UNKNOWN] if versions else []),
            *(str(s.frames), f"{s.span_s:.2f}", f"{s.rate_hz:.1f}" if s.rate_hz else ""),
        )
        for s in summaries[:_ROWS_LISTED]
    ]
    headers = ("log id", "config", *(["version"] if versions else []), "frames", "s", "frames/s")
    notes += (f"listed: the first {len(rows)} of {len(summaries)} runs",) if len(summaries) > len(rows) else ()
    return Table("Run", headers, rows, notes, label_columns=15)


def _groups_table(summaries: Sequence[Summary], by: Sequence[str], notes: tuple[str, ...]) -> Table:
    """A row for each group: numbers of logs and frames, the time of whole logs, and frames with all inputs."""
    whole = all(summary.segments for summary in summaries)
    rows = [
        (
            s.name,
            *(str(len(s.log_ids)), str(s.frames)),
            *([log_time(s.span_s)] if whole else []),
            percent(1 - s.incomplete / s.frames),
        )
        for s in summaries[:_ROWS_LISTED]
    ]
    headers = ("logs", "frames", *(["log time"] if whole else []), "inputs %")
    notes += (f"listed: the first {len(rows)} of {len(summaries)} groups",) if len(summaries) > len(rows) else ()
    if any(len(summary.configs) > 1 for summary in summaries):
        notes += (f"groups include several configurations; pass --by {','.join((*by, 'config'))} to separate them",)
    return Table(f"By {', '.join(by)}", headers, rows, notes, label_columns=15)


def _tables_by_run(summaries: Sequence[Summary]) -> Iterator[Table]:
    """Missing outputs that differ between runs, accuracy and latency, each with a line per run."""
    for table in (missing_outputs(summaries, vary_only=True), accuracy(summaries), latency(summaries)):
        yield replace(table, title=f"{table.title} by run", notes=())


def _left_out(subjects: Mapping[str, Sequence[Summary]]) -> Iterator[str]:
    """Lines on tables that do not list all their subjects."""
    for name, summaries in subjects.items():
        if len(summaries) > LISTED:
            yield f"by {name}: at most {LISTED} of {len(summaries)} per row, those with the worst p95"
