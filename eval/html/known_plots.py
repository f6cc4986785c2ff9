"""Plots known from other benchmarks: poses over time, error over distance, precision over recall."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from roadperc_stream.system.text import number

from ..objects.detection import RECALLS
from ..objects.figures import ObjectTally, detected
from .charts import Paths, without_scale
from .figures import TIME_TITLE, TRUTH_COLOUR, Figure, Series, colour_of, layout, line, thinned

_AXES: Final = {"x ahead": "m", "y to the left": "m", "z up": "m", "roll": "deg", "pitch": "deg", "yaw": "deg"}
_NOTE: Final = (
    "Matches within 2 m of the true place; AP is the mean over 0.5, 1, 2 and 4 m. "
    "Recall is among all true objects, also those without a detection."
)


def poses_over_time(runs: Sequence[Series], paths: Sequence[Paths]) -> Iterator[Figure]:
    """Position and rotation against the first pose over time, with the truth."""
    several, scaled = len(runs) > 1, not any(map(without_scale, runs))
    for at, (name, unit) in enumerate(_AXES.items()):
        traces = []
        for place, (run, found) in enumerate(zip(runs, paths, strict=True)):
            for which, poses in found.items():
                label, dash = ("truth", "dash") if which == "true" else ("odometry", "solid")
                colour = TRUTH_COLOUR if which == "true" and not several else colour_of(place)
                label, kept = f"{run.name}: {label}" if several else label, thinned(poses[:, at])
                more = {"dash": dash, "showlegend": dash == "solid" or not several}
                traces.append(line(label, run.since_start_s[kept], poses[kept, at], colour, **more))
        if traces:
            note = "Against the first pose. The truth is dashed."
            yield Figure(
                f"Pose: {name}",
                note,
                traces,
                layout(TIME_TITLE, f"{name}, {unit if scaled or unit == 'deg' else 'no scale'}"),
            )


def precision_recall(tallies: Mapping[str, ObjectTally]) -> Iterator[Figure]:
    """A chart for each class with a curve for each run, over all true objects; ``tallies`` are those of the runs."""
    for name in sorted({name for tally in tallies.values() for name in tally.classes}):
        traces = []
        for place, (run, tally) in enumerate(tallies.items()):
            found = detected(tally, name)
            if found is not None:
                kept = found.curve > 0
                kept[0] = True
                prefix = f"{run}: " if len(tallies) > 1 else ""
                label = f"{prefix}AP {found.mean:.2f}, {number(found.true, 'true object')}"
                traces.append(line(label, RECALLS[kept], found.curve[kept], colour_of(place)))
        axes = layout("recall", "precision", hovermode="closest")
        axes["xaxis"]["range"] = axes["yaxis"]["range"] = [0, 1.03]
        yield Figure(f"Precision and recall: {name}", _NOTE, traces, axes)
