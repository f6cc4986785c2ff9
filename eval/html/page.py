"""Renders the page into one file, including the charting library."""

import json
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import count
from pathlib import Path
from typing import Any, Final

import polars as pl
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from roadperc_stream.errors import TableError
from roadperc_stream.output.text_table import Table, values_of_subjects
from roadperc_stream.system.files import require_suffix, write_whole
from roadperc_stream.system.text import listed, shown

from ..compare.comparison import Comparison
from ..compare.verdicts import Mark
from ..configurations import UNKNOWN, grouped, settings_table, short_digest
from ..findings import findings_of, report_lines
from ..frame_commands import view_command, view_pair_command
from ..objects.figures import tallies
from ..objects.tables import object_tables
from ..report.full_tables import full_tables
from ..report.sources import load, source_of_runs
from ..report.stages import stages_of
from ..report.summaries import Summary, WorstFrame, frames_in_segments, groups_of_runs, summarise
from ..report_columns import AT_PLACE, percent, with_unit
from ..runs import Run, collect
from ..scan import rows_of
from .charts import ERROR_COLUMNS, POSE_COLUMNS, SCALE_COLUMNS, distributions, paths, trajectory
from .figures import Figure, load_series
from .known_plots import poses_over_time, precision_recall
from .over_time import COLUMNS, over_time, stage_times
from .pictures import WORST, Command, Gallery, Key, drawn_from_log, frames_of, gallery, log_of
from .verdict import Ranked, bars, comparison_of, place_text, ranked_frames, sentence, single_sentence

RUNS_DRAWN: Final = 8
"""Most runs on a page; there are as many colours."""
_NOT_NAMED: Final = "not named"
_NO_PARTS: Final[dict[str, Any]] = {
    **dict.fromkeys(("left_out", "compared", "lead", "gallery"), None),
    **dict.fromkeys(("findings", "bars", "ranked", "events"), ()),
    "charts": {},
}
"""The parts that only a page over runs has."""
Links = Mapping[str, str]
"""Addresses by label."""
_COLUMNS: Final = (*COLUMNS, *POSE_COLUMNS, *SCALE_COLUMNS, *ERROR_COLUMNS)


def identity(summaries: Sequence[Summary], runs: Sequence[Run]) -> Table:
    """Log, configuration, version, files and extent of each run."""
    facts = {summary.name: _facts(summary, run) for summary, run in zip(summaries, runs, strict=True)}
    labels = next(iter(facts.values()))
    values = {label: {name: of_run[label] for name, of_run in facts.items()} for label in labels}
    return values_of_subjects("What was replayed", values, list(facts))


def _facts(summary: Summary, run: Run) -> dict[str, str]:
    rate = f", {summary.rate_hz:.1f} frames/s" if summary.rate_hz else ""
    missing = ", ".join(f"{role} {percent(n / summary.frames)} %" for role, n in summary.missing.most_common())
    outputs = [log_of(table) for table in run.tables]
    return {
        "log": listed(summary.log_ids),
        "configuration": short_digest(summary.configs[0]),
        "version": summary.versions[0] or UNKNOWN,
        "input": listed([Path(table.source).name if table.source else _NOT_NAMED for table in run.tables]),
        "output": listed([log.name if log else _NOT_NAMED for log in outputs]),
        "frames": f"{frames_in_segments(summary)} over {summary.span_s:.2f} s{rate}",
        "longest gap": f"{summary.longest_gap_s:.2f} s",
        "messages missing": missing or "none in any frame",
    }


def write_page(target: Path, runs: Sequence[Run], command: Command = view_command) -> None:
    """Write the page over runs with frames to a ``.html`` or ``.htm`` file, as a partial file until complete.

    Raises:
        TableError: a table cannot be read.
        TargetError: the page cannot be written, or has another suffix.
    """
    require_suffix(target, ".html", ".htm")
    write_whole(target, _page(runs, command))


def _page(runs: Sequence[Run], command: Command) -> str:
    """The page as HTML, over the first ``RUNS_DRAWN`` runs; a note gives the number of the others."""
    drawn = runs[:RUNS_DRAWN]
    groups, frames = grouped(drawn), load(source_of_runs(drawn))
    names = [run.name for run in drawn]
    group_of = {run.name: group.name for group in groups for run in group.runs}
    groupings = [groups_of_runs(frames, names), groups_of_runs(frames, [group_of[name] for name in names])]
    summaries, together = summarise(frames, groupings, worst=WORST)
    by_name = {summary.name: summary for summary in summaries}
    series = [load_series(run, _COLUMNS) for run in drawn]
    verdicts = [single_sentence(summary) for summary in summaries]
    compared = None
    try:
        compared = comparison_of([(group.runs, [by_name[run.name] for run in group.runs]) for group in groups])
    except TableError as error:
        verdicts = [("unchanged", f"No comparison: {error}")]
    ranked = ranked_frames(together, WORST)
    lead = _lead(compared, ranked, drawn, command) or _middle(drawn[0], command)
    shown = [*(item.frame for item in ranked), *(lead.frames if lead else ())]
    pictures = gallery(shown, drawn, command)
    driven = [paths(run) for run in series]
    of_objects = dict(zip(names, tallies(frames, groupings[0]), strict=True))
    charts = {
        "Over time": [*over_time(series), *stage_times(series)],
        "Trajectory": [*trajectory(series, driven), *poses_over_time(series, driven)],
        "Precision and recall": list(precision_recall(of_objects)),
        "Error distributions": list(distributions(series)),
    }
    return render(
        names=names,
        left_out=len(runs) - len(drawn),
        findings=report_lines(findings_of(runs)),
        compared=compared is not None,
        verdicts=[sentence(compared)] if compared else verdicts,
        bars=bars(compared) if compared else [],
        stages=stages_of(summaries),
        lead=lead,
        ranked=[(item, with_unit(item.frame.value, item.quantity)) for item in ranked],
        gallery=pictures,
        pictures=_pictures(pictures, {(frame.run, frame.frame) for frame in shown}),
        tables=[
            (table, {})
            for table in (
                settings_table({run.name: run for run in drawn}),
                identity(summaries, drawn),
                *full_tables(summaries),
                *object_tables(of_objects),
            )
        ],
        **_charts(charts),
    )


@dataclass(frozen=True)
class Lead:
    """The worst frame: what is bad in it, its frame in each run, and the command that shows it."""

    text: str
    frames: tuple[WorstFrame, ...]
    command: str
    is_worst: bool = True


def _middle(run: Run, command: Command) -> Lead | None:
    """The frame in the middle of a log in which no frame is bad or judged; None if the log has no image of it."""
    for frame in frames_of(run, pl.int_range(pl.len()) == pl.len() // 2):
        if drawn_from_log([frame], (), run.table_of(frame.frame), bool)[0]:
            text = f"frame {frame.frame}, in the middle of the log"
            return Lead(text, (frame,), command(run, frame.frame), is_worst=False)
    return None


def _lead(compared: Comparison | None, ranked: Sequence[Ranked], runs: Sequence[Run], command: Command) -> Lead | None:
    """The frame in which the new run is worse by most, in both runs; else the first of the ranking."""
    place = next(iter(compared.worst_places), None) if compared else None
    if not ranked and not place:
        return None
    if compared and place:
        pair, stamp_ns, text = place.pair, place.stamp_ns, place_text(compared, place)
    else:
        frame, quantity = ranked[0].frame, ranked[0].quantity
        stamp_ns, text = frame.stamp_ns, f"frame {frame.frame}: {quantity.name} {with_unit(frame.value, quantity)}"
        pairs = compared.pairing.pairs if compared else ()
        found = next((pair for pair in pairs if frame.run in {pair.base.name, pair.new.name}), None)
        if found is None:
            run = next(run for run in runs if run.name == frame.run)
            later = _found_later(run, frame, quantity.column) if quantity.column in AT_PLACE else []
            return Lead(text, (frame, *later), command(run, frame.frame))
        pair, text = found, f"{frame.run}, {text}"
    both = [frame for run in (pair.base, pair.new) for frame in frames_of(run, pl.col("stamp_ns") == stamp_ns)[:1]]
    return Lead(text, tuple(both), view_pair_command(pair.base, pair.new, place.frame if place else both[-1].frame))


def _found_later(run: Run, frame: WorstFrame, column: str) -> list[WorstFrame]:
    """The frame that found what a frame claimed ahead."""
    found = rows_of(run).filter(pl.col("frame") == frame.frame).select(column.replace("hindsight_m", "hindsight_frame"))
    return frames_of(run, pl.col("frame") == collect(found, run.source_name).item())


def _pictures(found: Gallery, visible: Container[Key]) -> Markup:
    """Time, anchor, run, frame, command and image of each picture, for the script; no image if the page shows it."""
    pictures = [(key, picture) for key, picture in found.pictures.items() if picture.image]
    return as_json(
        [(p.frame.since_start_s, p.anchor, *key, p.command, "" if key in visible else p.image) for key, p in pictures]
    )


def as_json(content: Any) -> Markup:
    """Compact JSON for a script element; "<" is escaped, so that no name can end the element."""
    return Markup(json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"))


def render(
    names: Sequence[str], verdicts: Sequence[tuple[Mark, str]], tables: Sequence[tuple[Table, Links]], **more: Any
) -> str:
    """The page; ``verdicts`` are marks with a line each, and ``tables`` have addresses of other pages by label.

    ``more`` are the parts of the page over runs.
    """
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, finalize=_text, trim_blocks=True, lstrip_blocks=True
    )
    parts = {"style": _part("page.css"), "names": names, "verdicts": verdicts, "tables": tables, **_NO_PARTS, **more}
    return environment.from_string(_part("page.html")).render(parts)


def _charts(charts: Mapping[str, Sequence[Figure]]) -> dict[str, Any]:
    """The charts for the template: each figure gets an identifier, and sections without figures are left out."""
    numbers = count(1)
    filled = {section: figures for section, figures in charts.items() if figures}
    named = {section: [(f"chart-{next(numbers)}", figure) for figure in figures] for section, figures in filled.items()}
    specs = {name: figure.spec for figures in named.values() for name, figure in figures}
    scripts = {"plotly": Markup(get_plotlyjs()), "script": _part("page.js")}
    return {"charts": named, "specs": as_json(specs), **scripts}


def _text(value: Any) -> Any:
    """A value for the page; texts with unprintable characters are escaped."""
    plain = not isinstance(value, str) or isinstance(value, Markup) or value.isprintable()
    return value if plain else shown(value)


def _part(name: str) -> Markup:
    return Markup(resources.files(__package__).joinpath(name).read_text(encoding="utf-8"))
