"""Shows two runs of one log in one recording, because the viewer does not synchronise two.

The entities are below ``/base`` and ``/new``. Inputs and transforms come from the base; both runs are drawn in its
frames, so that their lanes and boxes compare in the car's frame.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any, Final, cast

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from roadperc_stream.model import EGO
from roadperc_stream.schemas import topics
from roadperc_stream.system.progress import Progress
from roadperc_stream.view.differences import MetricDifference
from roadperc_stream.view.frame_times import Stop
from roadperc_stream.view.rerun.blueprint import Log, arranged, curves, in_tabs, picture_with_results
from roadperc_stream.view.rerun.recording import Export, Exported, Sender, ShownLog, opened, send_log
from roadperc_stream.view.rerun.timelines import LOG_TIME, time_panel

BASE, NEW = "/base", "/new"
_COLOURS: Final = {BASE: (255, 150, 0), NEW: (0, 190, 255)}
_RADII_M: Final = {BASE: 0.14, NEW: 0.06}
"""So that both runs are visible where they agree."""
_WIDTHS: Final = {BASE: 3.0, NEW: 1.2}
_DIFFERENCES: Final = "/differences"
_MOST_CURVES: Final = 6
_MOST_LISTED: Final = 12
_OFFSETS: Final = tuple(f"{topics.METRICS_TOPIC}/lane_{side}_offset_m" for side in ("left", "right"))
_STRIPS: Final = (f"{topics.LANES_TOPIC}/scene", topics.TRAJECTORY_TOPIC)
_BOXES: Final = f"{topics.OBJECTS_TOPIC}/scene"
_FROM_ABOVE: Final = rrb.EyeControls3D(position=(14.0, 0.0, 42.0), look_target=(14.5, 0.0, 0.0), eye_up=(1.0, 0.0, 0.0))


def export_of_pair(
    base: ShownLog, new: ShownLog, differences: Sequence[MetricDifference], progress: Progress
) -> Export:
    """A function that logs both runs, their differences and a blueprint to a recording.

    Args:
        base: the run with inputs and transforms; its stop is that of the recording.
        new: the run of which only results are shown.
        differences: from ``find_differences``.
        progress: called with the frames of one run after the other.

    Raises:
        LogError: a log is unreadable or has nothing to show.
    """
    runs = replace(base, root=BASE), replace(new, root=NEW, only_results=True, stop=base.stop)
    found = [(run, *opened(run.path, run.overrides)) for run in runs]

    def export(recording: rr.RecordingStream, keep_up: Callable[[], None]) -> Exported:
        senders = [Sender(recording, summary, roles, run) for run, summary, roles in found]
        exported = [send_log(sender, progress, keep_up) for sender in senders]
        _log_differences(recording, differences, base.stop)
        ours, theirs = (sender.log for sender in senders)
        recording.send_blueprint(_blueprint(ours, theirs, differences, base.stop))
        notes = dict.fromkeys(note for one in exported for note in one.notes)
        problems = {topic: count for one in exported for topic, count in one.problems.items()}
        return Exported(exported[0].frames, tuple(notes), problems)

    return export


def _log_differences(recording: rr.RecordingStream, differences: Iterable[MetricDifference], stop: Stop | None) -> None:
    """Log curves of the differences, points at the worst ones, and a list of these."""
    for found in differences:
        _send(recording, f"{_DIFFERENCES}/{found.name}", found.times_ns, found.values, stop)
        if found.worst is not None:
            at = found.times_ns == found.worst.log_time_ns
            _send(recording, f"{_DIFFERENCES}/worst/{found.name}", found.times_ns[at], found.values[at], stop)
    worst = [found.text for found in differences if found.worst is not None]
    lines = [
        "The new run is worse by most in these frames:\n",
        "| frame | metric | base | new |",
        "|---|---|---|---|",
        *worst[:_MOST_LISTED],
    ]
    text = "\n".join(lines) if worst else "The new run is nowhere worse by a relevant effect."
    recording.log(f"{_DIFFERENCES}/list", rr.TextDocument(text, media_type="text/markdown"), static=True)


def _send(recording: rr.RecordingStream, entity: str, times_ns: Any, values: Any, stop: Stop | None) -> None:
    """Send a curve; its part up to the stop also on the stop's timeline."""
    until = times_ns <= (stop.log_time_ns if stop else -1)
    for chosen, names in ((until, [LOG_TIME, stop.name if stop else ""]), (~until, [LOG_TIME])):
        if chosen.any():
            times = np.array(times_ns[chosen], "datetime64[ns]")
            indexes = [rr.TimeColumn(name, timestamp=times) for name in names]
            recording.send_columns(entity, indexes, rr.Scalars.columns(scalars=values[chosen]))


def _blueprint(base: Log, new: Log, differences: Sequence[MetricDifference], stop: Stop | None) -> rrb.Blueprint:
    pictures = [picture_with_results(f"{log.root[1:]}: image and results", base, log) for log in (base, new)]
    shown = [*(view for view in pictures if view is not None), _from_above(base, new)]
    below = [_list_view(), in_tabs(_plots(differences)), _offsets(base, new)]
    rows = [rrb.Horizontal(*shown), rrb.Horizontal(*(view for view in below if view is not None))]
    return arranged(rows, time_panel(stop))


def _list_view() -> rrb.View:
    return rrb.TextDocumentView(origin=f"{_DIFFERENCES}/list", name="worst differences")


def _plots(differences: Sequence[MetricDifference]) -> list[rrb.View]:
    """A plot for each unit, the one with the worst difference first."""
    order = list(dict.fromkeys(found.unit for found in differences))
    by_unit = groupby(sorted(differences, key=lambda found: order.index(found.unit)), key=lambda found: found.unit)
    plots = []
    for unit, group in by_unit:
        lines: dict[str, rr.SeriesLines | rr.SeriesPoints | None] = {}
        for found in list(group)[:_MOST_CURVES]:
            lines[f"{_DIFFERENCES}/{found.name}"] = rr.SeriesLines(names=found.name, widths=1.5)
            if found.worst is not None:
                point = rr.SeriesPoints(names=f"worst {found.name}", markers="circle", marker_sizes=6.0)
                lines[f"{_DIFFERENCES}/worst/{found.name}"] = point
        plots.append(curves(f"new - base, {unit or 'ratio'}", lines))
    return plots


def _offsets(base: Log, new: Log) -> rrb.View:
    lines = {
        f"{log.root}{entity}": rr.SeriesLines(
            names=f"{log.root[1:]} {entity.split('_')[1]}", colors=_COLOURS[log.root], widths=_WIDTHS[log.root]
        )
        for log in (base, new)
        for entity in log.present(_OFFSETS)
    }
    return curves("lane offsets, m", lines)


def _from_above(base: Log, new: Log) -> rrb.View:
    """Lanes, boxes and trajectories of both runs, each in one colour, from above the car of the base."""
    overrides: dict[str, Any] = {}
    for log in (base, new):
        colour = [_COLOURS[log.root]]
        for entity in log.present(_STRIPS):
            overrides[f"{log.root}{entity}"] = rr.LineStrips3D.from_fields(colors=colour, radii=_RADII_M[log.root])
        for entity in log.present([_BOXES]):
            overrides[f"{log.root}{entity}"] = rr.Boxes3D.from_fields(colors=colour, radii=_RADII_M[log.root])
    return rrb.Spatial3DView(
        origin="/",
        name="from above: base orange, new blue",
        contents=[*overrides],
        overrides=cast("Any", overrides),  # the stubs of the SDK expect keys of a union type
        spatial_information=rrb.SpatialInformation(target_frame=EGO),
        eye_controls=_FROM_ABOVE,
        line_grid=True,
    )
