"""Charts over time: lane offsets, distances, inliers, and the time of each stage."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from roadperc_stream.geometry import Float

from ..report_columns import REST, SIDES, STAGE_TIMES, TOTAL
from .figures import TIME_TITLE, TRUTH_COLOUR, Figure, Series, Trace, colour_of, layout, line, thinned, wider


@dataclass(frozen=True)
class Kind:
    """A column in a chart: its name there and the style of its line."""

    column: str
    name: str
    width: float = 1.8
    dash: str = "solid"
    truth: bool = False


@dataclass(frozen=True)
class TimeChart:
    """Columns with a common axis."""

    title: str
    unit: str
    kinds: tuple[Kind, ...]
    note: str = ""
    highest: float | None = None
    """Upper end of the axis from 0, if larger values do not matter."""


CHARTS: Final = (
    *(
        TimeChart(
            f"Lane boundary, {side}",
            "lateral offset, m",
            (
                Kind(f"lane_{side}_raw_offset_m", "raw", 1.0, "dot"),
                Kind(f"lane_{side}_offset_m", "smoothed", 2.0),
                Kind(f"lane_{side}_true_offset_m", "truth", 1.6, "dash", truth=True),
            ),
            "Lateral offset from the car's axis, positive to the left. A gap is a frame without the boundary.",
        )
        for side in SIDES
    ),
    TimeChart(
        "Distances",
        "distance, m",
        (
            Kind("nearest_object_m", "nearest object"),
            Kind("stereo_nearest_m", "nearest in stereo", 1.4, "dash"),
        ),
        "The nearest kept object, and the nearest point of stereo.",
    ),
    TimeChart(
        "Time to impact",
        "time to impact, s",
        (
            Kind("time_to_impact_s", "shortest"),
            Kind("true_time_to_impact_s", "truth", 1.6, "dash", truth=True),
        ),
        "The shortest of the objects in the car's path, up to 10 s.",
        highest=10.0,
    ),
    TimeChart(
        "Surface inliers",
        "share of points",
        (Kind("surface_inlier_ratio", "inlier ratio"),),
        "Share of the road's points that lie on the plane.",
    ),
    TimeChart(
        "Odometry inliers", "number of points", (Kind("odometry_inliers", "inliers"),), "Points the motion agrees with."
    ),
)
STAGE_COLUMNS: Final = tuple(stage.column for stage in STAGE_TIMES if stage != REST)
_AROUND_THE_CHAIN: Final = {"read": "#93c5fd", "metrics": "#fca5a5", "copy": "#6ee7b7", "write": "#fcd34d"}
_STAGES: Final = (s.name for s in STAGE_TIMES if s not in {REST, TOTAL} and s.name not in _AROUND_THE_CHAIN)
_STAGE_COLOURS: Final = {
    **{name: colour_of(place) for place, name in enumerate(_STAGES)},
    **_AROUND_THE_CHAIN,
    REST.name: "#9ca3af",
}
COLUMNS: Final = (*(kind.column for chart in CHARTS for kind in chart.kinds), *STAGE_COLUMNS)
"""Columns of these charts."""


def over_time(runs: Sequence[Series]) -> Iterator[Figure]:
    """The charts with values; all runs share each chart."""
    for chart in CHARTS:
        traces = [trace for place in range(len(runs)) for trace in _traces(chart, runs, place)]
        if traces:
            look = layout(TIME_TITLE, chart.unit, showlegend=len(traces) > 1)
            if chart.highest is not None:
                look["yaxis"] |= {"range": [0, chart.highest], "autorange": False}
            yield Figure(chart.title, _note(chart, len(runs)), traces, look)


def _traces(chart: TimeChart, runs: Sequence[Series], place: int) -> Iterator[Trace]:
    """A line for each kind; with several runs the colour shows the run, the dash the kind; one legend entry per run."""
    run, several = runs[place], len(runs) > 1
    present = [kind for kind in chart.kinds if kind.column in run.values]
    keyed = next((kind for kind in present if kind.dash == "solid"), present[0] if present else None)
    for kind in present:
        more: dict[str, Any] = {"width": kind.width, "wider": wider(runs, place, kind.column), "dash": kind.dash}
        if several:
            more |= {"legendgroup": f"run {place}", "showlegend": kind is keyed, "hovertemplate": f"%{{y}} {kind.name}"}
        at = chart.kinds.index(kind)
        alone = TRUTH_COLOUR if kind.truth else colour_of(1 - at if at < 2 else at)
        name, colour = (run.name, colour_of(place)) if several else (kind.name, alone)
        yield _thinned_line(name, run, kind.column, colour, **more)


def _thinned_line(name: str, run: Series, column: str, colour: str, **more: Any) -> Trace:
    kept = thinned(run.values[column])
    return line(name, run.since_start_s[kept], run.values[column][kept], colour, **more)


def _note(chart: TimeChart, runs: int) -> str:
    return f"{_meaning(chart, runs)} Columns: {', '.join(kind.column for kind in chart.kinds)}.".strip()


def _meaning(chart: TimeChart, runs: int) -> str:
    if runs == 1 or len(chart.kinds) == 1:
        return chart.note
    dashes = {"solid": "solid", "dot": "dotted", "dash": "dashed"}
    looks = ", ".join(f"{kind.name} {dashes[kind.dash]}" for kind in chart.kinds)
    return f"{chart.note} {looks.capitalize()}.".strip()


def stage_times(runs: Sequence[Series]) -> Iterator[Figure]:
    """Times over time: of one run those of the stages, stacked; of several runs the totals."""
    if len(runs) == 1:
        yield from _stacked(runs[0])
        return
    timed = [(place, run) for place, run in enumerate(runs) if TOTAL.column in run.values]
    totals = [_thinned_line(run.name, run, TOTAL.column, colour_of(place)) for place, run in timed]
    if totals:
        yield Figure("Time of a frame", "The sum over all stages.", totals, layout(TIME_TITLE, "time of a frame, ms"))


def _stacked(run: Series) -> Iterator[Figure]:
    if TOTAL.column not in run.values:
        return
    # All stages are thinned to the same frames, by the total, so that the areas add up to each frame's total.
    kept = thinned(run.values[TOTAL.column])
    traces = []
    for name, took_ms in _stages(run).items():
        colour = _STAGE_COLOURS[name]
        red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
        trace = line(name, run.since_start_s[kept], took_ms[kept], colour, width=0.5)
        traces.append({**trace, "stackgroup": "stages", "fillcolor": f"rgba({red},{green},{blue},0.72)"})
    note = "Stacked: the upper edge is the frame's total."
    yield Figure("Time per stage", note, traces, layout(TIME_TITLE, "time of a frame, ms", height=340))


def _stages(run: Series) -> dict[str, Float]:
    """Milliseconds of each stage, 0 if it did not run, and the rest of the frame's time."""
    names = {stage.column: stage.name for stage in STAGE_TIMES if stage not in {REST, TOTAL}}
    stages = {names[column]: np.nan_to_num(run.values[column]) for column in names if column in run.values}
    rest = run.values[TOTAL.column] - sum(stages.values(), np.zeros(len(run.since_start_s)))
    return {**stages, REST.name: np.maximum(rest, 0.0)}
