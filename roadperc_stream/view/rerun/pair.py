"""Shows two runs of one log in one recording, because the viewer does not synchronise two.

The entities are below ``/base`` and ``/new``. Inputs and transforms come from the base; both runs are drawn in its
frames, so that their lanes and boxes compare in the car's frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final, cast

import rerun as rr
import rerun.blueprint as rrb

from roadperc_stream.log import AnyLog
from roadperc_stream.model import EGO
from roadperc_stream.schemas import topics
from roadperc_stream.view.differences import MetricDifference
from roadperc_stream.view.frame_times import Stop
from roadperc_stream.view.rerun.blueprint import Log, arranged, curves, in_tabs, picture_with_results
from roadperc_stream.view.rerun.timelines import send_curve, time_panel

BASE, NEW = "/base", "/new"
_LOOKS: Final = {BASE: ((255, 150, 0), 0.14), NEW: ((0, 190, 255), 0.06)}
"""Colour, and radius in m: both runs are visible where they agree."""
_DIFFERENCES: Final = "/differences"
_MOST_CURVES: Final = 6
_STRIPS: Final = (f"{topics.LANES_TOPIC}/scene", topics.TRAJECTORY_TOPIC)
_BOXES: Final = f"{topics.OBJECTS_TOPIC}/scene"
_FROM_ABOVE: Final = rrb.EyeControls3D(position=(14.0, 0.0, 42.0), look_target=(14.5, 0.0, 0.0), eye_up=(1.0, 0.0, 0.0))


@dataclass(frozen=True)
class Opening:
    """What to show with a log.

    ``stop`` is the frame to open at, None for the end. ``new`` is a second run of the log, to compare with the first;
    ``differences`` are those of the two, from ``find_differences``.
    """

    stop: Stop | None = None
    new: AnyLog | None = None
    differences: Sequence[MetricDifference] = ()


def arrange_pair(recording: rr.RecordingStream, runs: Sequence[Log], shown: Opening) -> None:
    """Log curves of the differences with points at the worst ones, and the blueprint of base and new run."""
    for found in shown.differences:
        parts = {found.name: found.times_ns >= 0}
        if found.worst is not None:
            parts[f"worst/{found.name}"] = found.times_ns == found.worst.log_time_ns
        for name, at in parts.items():
            send_curve(recording, f"{_DIFFERENCES}/{name}", found.times_ns[at], found.values[at], shown.stop)
    pictures = [picture_with_results(f"{log.root[1:]}: image and results", runs[0], log) for log in runs]
    views = [*chain.from_iterable(pictures), _from_above(runs)]
    plots = in_tabs(_plots(shown.differences)) or rrb.TextDocumentView(name="no relevant difference")
    recording.send_blueprint(arranged([rrb.Horizontal(*views), rrb.Horizontal(plots)], time_panel(shown.stop)))


def _plots(differences: Sequence[MetricDifference]) -> list[rrb.View]:
    """A plot for each unit, the one with the worst difference first."""
    plots = []
    for unit in dict.fromkeys(found.column.unit for found in differences):
        lines: dict[str, rr.SeriesLines | rr.SeriesPoints | None] = {}
        for found in [found for found in differences if found.column.unit == unit][:_MOST_CURVES]:
            lines[f"{_DIFFERENCES}/{found.name}"] = rr.SeriesLines(names=found.name, widths=1.5)
            if found.worst is not None:
                point = rr.SeriesPoints(names=found.text, markers="circle", marker_sizes=6.0)
                lines[f"{_DIFFERENCES}/worst/{found.name}"] = point
        plots.append(curves(f"new - base, {unit or 'ratio'}", lines))
    return plots


def _from_above(runs: Sequence[Log]) -> rrb.View:
    """Lanes, boxes and trajectories of both runs, each in one colour, from above the car of the base."""
    overrides: dict[str, Any] = {}
    for log in runs:
        colour, radius_m = _LOOKS[log.root]
        for entity in log.present([*_STRIPS, _BOXES]):
            kind = rr.Boxes3D if entity == _BOXES else rr.LineStrips3D
            overrides[f"{log.root}{entity}"] = kind.from_fields(colors=[colour], radii=radius_m)
    return rrb.Spatial3DView(
        origin="/",
        name="from above: base orange, new blue",
        contents=[*overrides],
        overrides=cast("Any", overrides),  # the stubs of the SDK expect keys of a union type
        spatial_information=rrb.SpatialInformation(target_frame=EGO),
        eye_controls=_FROM_ABOVE,
        line_grid=True,
    )
