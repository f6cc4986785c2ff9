"""Puts the page together: everything in one file, the charting library included."""

import json
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from roadperc_stream.core.files import completing, require_suffix
from roadperc_stream.core.text import shown
from roadperc_stream.output.text_table import by_header

from ..configurations import grouped, settings_table
from ..runs import Run
from ..sections import sections
from ..summary import summarise_group
from . import histograms, over_time, trajectory
from .figures import Figure
from .pictures import WORST, gallery
from .series import load_series
from .sources import sources_of
from .tables import identity

RUNS_DRAWN: Final = 8
"""Runs side by side: as many as there are colours to tell them apart."""
_COLUMNS: Final = (*over_time.COLUMNS, *trajectory.COLUMNS, *histograms.COLUMNS)


def write_page(target: Path, runs: Sequence[Run]) -> None:
    """Write the page over runs with frames, ``.html`` or ``.htm``; it appears under its name only when complete.

    Raises:
        TableError: a table cannot be read.
        TargetError: the page cannot be written, or not under this name.
    """
    require_suffix(target, ".html", ".htm")
    text = page(runs)
    with completing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page(runs: Sequence[Run]) -> str:
    """The page as HTML; of more than ``RUNS_DRAWN`` runs the first are shown, and the page says so.

    Raises:
        TableError: a table cannot be read.
    """
    drawn = runs[:RUNS_DRAWN]
    groups = grouped(drawn)
    frames = max(WORST // len(groups), 1)
    found = [summarise_group(group, frames) for group in groups]
    by_name = {summary.name: summary for group in found for summary in group.runs}
    summaries = [by_name[run.name] for run in drawn]
    sources = {run.name: sources_of(run) for run in drawn}
    series = [load_series(run, _COLUMNS) for run in drawn]
    from_above = trajectory.trajectory(series)
    charts = {
        "Over time": [*over_time.over_time(series), *over_time.stage_times(series, summaries)],
        "From above": [from_above] if from_above else [],
        "Error distributions": list(histograms.histograms(series)),
    }
    return _render(
        names=[run.name for run in drawn],
        left_out=len(runs) - len(drawn),
        overview=[settings_table({run.name: run for run in drawn}), identity(summaries, list(sources.values()))],
        tables=list(sections(summaries)),
        by_header=by_header,
        charts=_numbered(charts),
        gallery=gallery([group.together for group in found], sources),
    )


def _numbered(charts: Mapping[str, Sequence[Figure]]) -> dict[str, list[tuple[str, Figure]]]:
    """Each section's figures with the identifier each has in the page; sections without any are left out."""
    numbers = iter(range(1, sum(len(figures) for figures in charts.values()) + 1))
    return {
        section: [(f"chart-{next(numbers)}", figure) for figure in figures]
        for section, figures in charts.items()
        if figures
    }


def _render(charts: Mapping[str, Sequence[tuple[str, Figure]]], **content: Any) -> str:
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, finalize=_text, trim_blocks=True, lstrip_blocks=True
    )
    specs = {name: figure.spec for figures in charts.values() for name, figure in figures}
    return environment.from_string(_part("page.html")).render(
        charts=charts,
        specs=_json(specs),
        style=Markup(_part("page.css")),
        script=Markup(_part("page.js")),
        plotly=Markup(get_plotlyjs()),
        **content,
    )


def _text(value: Any) -> Any:
    """A value as the page shows it; a picture's bytes, which are printable, come whole."""
    plain = not isinstance(value, str) or isinstance(value, Markup) or value.isprintable()
    return value if plain else shown(value)


def _json(content: object) -> Markup:
    """JSON that may stand in a script element: no name in it can end the element."""
    return Markup(json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"))


def _part(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
