"""The figures of runs as tables and lines, as rich renderables."""

from collections.abc import Mapping, Sequence
from typing import Final

from rich.table import Table

from roadperc_stream.cli.terminal import grid

from ..grid import percent
from .alignment import Alignment
from .errors import Delta, ErrorStatistics
from .judgement import Judgement, Segments

_ALIGNED: Final[Mapping[Alignment, str]] = {
    "se3": "aligned by SE(3)",
    "sim3": "aligned by Sim(3)",
    "origin": "first pose on the first true one",
    "none": "not aligned",
}


def coverage(judgement: Judgement) -> str:
    """How much of the run the figures are over."""
    run = judgement.run
    return (
        f"{run.name}: {run.frames} frames, {judgement.driven_m:.1f} m driven\n"
        f"{percent(run.coverage)} % have both poses: "
        f"estimated {run.estimated_frames}, true {run.true_frames}, lost {run.lost}"
    )


def alignment(judgement: Judgement) -> str:
    """How the estimate was laid over the truth."""
    scale = f", the estimate scaled by {judgement.scale:.6g}" if judgement.alignment == "sim3" else ""
    return f"{_ALIGNED[judgement.alignment]}{scale}"


def without_scale(judgement: Judgement) -> str:
    """What steps without scale mean for the figures; empty where there are none."""
    run = judgement.run
    counted = f"{run.without_scale} of {run.steps} steps have no scale"
    if run.up_to_scale:
        rest = "" if judgement.alignment == "sim3" else ", and these are not: --align sim3"
        return f"up to scale ({counted}): only figures aligned by Sim(3) mean anything{rest}"
    return f"{counted} of their own: those before and after them give it" if run.without_scale else ""


def errors(judgement: Judgement) -> Table:
    """Absolute and relative errors."""
    table = grid("Error", "values", "RMSE", "mean", "median", "std", "min", "max", "SSE", label_columns=22)
    delta = delta_text(judgement.delta)
    table.add_row("ATE, m", *_cells(judgement.absolute_m))
    table.add_row(f"RPE over {delta}, m", *_cells(judgement.relative_m))
    table.add_row(f"RPE over {delta}, deg", *_cells(judgement.relative_deg))
    return table


def stretches(judgement: Judgement) -> Table:
    """KITTI's errors by length; a length of which no stretch fits has none."""
    table = grid("KITTI", "segments", "translation %", "rotation deg/100 m")
    for segments in (*judgement.stretches, judgement.together):
        label = "all" if segments.length_m is None else f"{segments.length_m:.0f} m"
        table.add_row(label, str(segments.count), *_segment_cells(segments))
    return table


def lengths(judgement: Judgement) -> str:
    """Which lengths KITTI's errors are over, and why."""
    own = f"a segment begins at every {judgement.every}th frame, as in KITTI's benchmark"
    short = "no 100 m driven: shorter lengths than KITTI's; a segment begins at every frame"
    return own if judgement.every > 1 else short


def runs(judgements: Sequence[Judgement]) -> Table:
    """How much of each of several runs the figures are over, and how they came about."""
    headers = ("frames", "both %", "lost", "driven m", "scale")
    table = grid("Run", *headers, text="KITTI over", label_columns=20)
    for judgement in judgements:
        run = judgement.run
        counts = (str(run.frames), percent(run.coverage), str(run.lost), f"{judgement.driven_m:.1f}")
        table.add_row(run.name, *counts, f"{judgement.scale:.4g}", _used_lengths(judgement.stretches))
    return table


def side_by_side(judgements: Sequence[Judgement]) -> Table:
    """A row of figures for each of several runs."""
    headers = ("align", "ATE m", "RPE m", "RPE deg", "KITTI %", "deg/100 m", "segments")
    table = grid(f"RMSE, RPE over {delta_text(judgements[0].delta)}", *headers, label_columns=20)
    for judgement in judgements:
        found = (judgement.absolute_m, judgement.relative_m, judgement.relative_deg)
        rmse = [_number(statistics.rmse if statistics else None) for statistics in found]
        together = judgement.together
        table.add_row(judgement.run.name, judgement.alignment, *rmse, *_segment_cells(together), str(together.count))
    return table


def delta_text(delta: Delta) -> str:
    """How far apart the poses of a pair are."""
    if delta.unit == "metres":
        return f"{delta.size:g} m"
    return f"{delta.size:g} frame{'s' * (delta.size != 1)}"


def _used_lengths(found: Sequence[Segments]) -> str:
    """The lengths of which a segment fits."""
    used = [f"{segments.length_m:.0f}" for segments in found if segments.length_m and segments.count]
    return f"{', '.join(used)} m" if used else "no length"


def _segment_cells(segments: Segments) -> list[str]:
    return [_number(value) for value in (segments.translation_percent, segments.rotation_deg_per_100m)]


def _cells(found: ErrorStatistics | None) -> list[str]:
    if found is None:
        return ["0"]
    values = (found.rmse, found.mean, found.median, found.std, found.least, found.most, found.sse)
    return [str(found.count), *(_number(value) for value in values)]


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:z.4f}"
