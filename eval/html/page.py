"""Renders the page into one file, including the charting library."""

import json
from collections.abc import Mapping, Sequence
from importlib import resources
from itertools import count
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from roadperc_stream.output.text_table import TextRow, TextTable, by_header
from roadperc_stream.system.files import completing, require_suffix
from roadperc_stream.system.text import shown

from ..configurations import UNKNOWN, grouped, settings_table, short_digest
from ..quantities import listed, percent
from ..report import in_segments
from ..runs import Run
from ..sections import sections
from ..summary import Summary, summarise_group
from .charts import ERROR_COLUMNS, POSE_COLUMNS, histograms, trajectory
from .figures import Figure, load_series
from .over_time import COLUMNS, over_time, stage_times
from .pictures import WORST, gallery, log_of

RUNS_DRAWN: Final = 8
"""Most runs on a page; there are as many colours."""
_NOT_NAMED: Final = "not named"
_COLUMNS: Final = (*COLUMNS, *POSE_COLUMNS, *ERROR_COLUMNS)


def identity(summaries: Sequence[Summary], runs: Sequence[Run]) -> TextTable:
    """Log, configuration, version, files and extent of each run."""
    facts = [_facts(summary, run) for summary, run in zip(summaries, runs, strict=True)]
    rows = tuple(TextRow(label, tuple((fact[label],) for fact in facts)) for label in facts[0])
    return TextTable("What was replayed", ("",), rows, subjects=tuple(summary.name for summary in summaries))


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
        "frames": f"{summary.frames}{in_segments(summary)} over {summary.span_s:.2f} s{rate}",
        "longest gap": f"{summary.longest_gap_s:.2f} s",
        "messages missing": missing or "none in any frame",
    }


def write_page(target: Path, runs: Sequence[Run]) -> None:
    """Write the page over runs with frames to a ``.html`` or ``.htm`` file, as a partial file until complete.

    Raises:
        TableError: a table cannot be read.
        TargetError: the page cannot be written, or has another suffix.
    """
    require_suffix(target, ".html", ".htm")
    text = _page(runs)
    with completing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _page(runs: Sequence[Run]) -> str:
    """The page as HTML, over the first ``RUNS_DRAWN`` runs; a note gives the number of the others."""
    drawn = runs[:RUNS_DRAWN]
    groups = grouped(drawn)
    frames = max(WORST // len(groups), 1)
    found = [summarise_group(group, frames) for group in groups]
    by_name = {summary.name: summary for of_group, _ in found for summary in of_group}
    summaries = [by_name[run.name] for run in drawn]
    series = [load_series(run, _COLUMNS) for run in drawn]
    from_above = trajectory(series)
    charts = {
        "Over time": [*over_time(series), *stage_times(series, summaries)],
        "From above": [from_above] if from_above else [],
        "Error distributions": list(histograms(series)),
    }
    return _render(
        names=[run.name for run in drawn],
        left_out=len(runs) - len(drawn),
        overview=[settings_table({run.name: run for run in drawn}), identity(summaries, drawn)],
        tables=list(sections(summaries)),
        by_header=by_header,
        charts=charts,
        gallery=gallery([together for _, together in found], drawn),
    )


def _render(charts: Mapping[str, Sequence[Figure]], **content: Any) -> str:
    """Render the template; each figure gets an identifier, and sections without figures are left out."""
    numbers = count(1)
    filled = {section: figures for section, figures in charts.items() if figures}
    named = {section: [(f"chart-{next(numbers)}", figure) for figure in figures] for section, figures in filled.items()}
    specs = {name: figure.spec for figures in named.values() for name, figure in figures}
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, finalize=_text, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(_part("page.html")).render(
        charts=named,
        # "<" is escaped, so that no name can end the script element
        specs=Markup(json.dumps(specs, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")),
        style=Markup(_part("page.css")),
        script=Markup(_part("page.js")),
        plotly=Markup(get_plotlyjs()),
        **content,
    )


def _text(value: Any) -> Any:
    """A value for the page; texts with unprintable characters are escaped."""
    plain = not isinstance(value, str) or isinstance(value, Markup) or value.isprintable()
    return value if plain else shown(value)


def _part(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
