"""The figures of runs as tables and lines."""

from collections.abc import Mapping, Sequence
from typing import Final

from roadperc_stream.core.text import number
from roadperc_stream.output.text_table import TextTable, row

from ..grid import percent
from ..names import listed
from ..options import Alignment
from .errors import Delta, ErrorStatistics
from .evaluation import Evaluation, Segments
from .poses import RunPoses

_ALIGNED: Final[Mapping[Alignment, str]] = {
    "se3": "aligned by SE(3)",
    "sim3": "aligned by Sim(3)",
    "origin": "first pose on the first true one",
    "none": "not aligned",
}

_EACH: Final = ", each segment of the log by itself"


def coverage(evaluation: Evaluation) -> tuple[str, str]:
    """How much of the run the figures are over, in two lines."""
    run = evaluation.run
    return (
        f"{run.name}: {run.frames} frames{_in_segments(run)}, {evaluation.driven_m:.1f} m driven",
        f"{percent(run.coverage)} % have both poses: "
        f"estimated {run.estimated_frames}, true {run.true_frames}, lost {run.lost}",
    )


def alignment(evaluation: Evaluation) -> str:
    """How the estimate was aligned to the truth."""
    scales = listed([f"{scale:.6g}" for scale in evaluation.scales])
    scale = f", the estimate scaled by {scales}" if evaluation.alignment == "sim3" else ""
    return f"{_ALIGNED[evaluation.alignment]}{_EACH if _in_segments(evaluation.run) else ''}{scale}"


def segments(evaluation: Evaluation) -> str:
    """Of how many segments the log is; empty where it is one."""
    found = _in_segments(evaluation.run)
    return f"{evaluation.run.frames} frames{found}{_EACH}" if found else ""


def _in_segments(run: RunPoses) -> str:
    """How many segments of the log have poses, where there are several."""
    segments = len(run.of_segments)
    return f" in {segments} segments of the log" if segments > 1 else ""


def without_scale(evaluation: Evaluation) -> str:
    """What steps without scale mean for the figures; empty where there are none."""
    run = evaluation.run
    counted = f"{run.without_scale} of {run.steps} steps have no scale"
    if run.up_to_scale:
        rest = "" if evaluation.alignment == "sim3" else ", and these are not: --align sim3"
        return f"up to scale ({counted}): only figures aligned by Sim(3) mean anything{rest}"
    return f"{counted} of their own: those before and after them give it" if run.without_scale else ""


def errors(evaluation: Evaluation) -> TextTable:
    """Absolute and relative errors."""
    rows = (
        row("ATE, m", *_cells(evaluation.absolute_m)),
        row("RPE, m", *_cells(evaluation.relative_m)),
        row("RPE, deg", *_cells(evaluation.relative_deg)),
    )
    headers = ("values", "RMSE", "mean", "median", "std", "min", "max", "SSE")
    return TextTable("Error", headers, rows, (_rpe(evaluation.delta),), label_columns=22)


def stretches(evaluation: Evaluation) -> TextTable:
    """KITTI's errors by length; a length of which no stretch fits has none."""
    segments = (*evaluation.stretches, evaluation.together)
    rows = tuple(row(_length(item), str(item.count), *_segment_cells(item)) for item in segments)
    headers = ("segments", "translation %", "rotation deg/100 m")
    return TextTable("KITTI", headers, rows, (lengths(evaluation),))


def _length(segments: Segments) -> str:
    return "all" if segments.length_m is None else f"{segments.length_m:.0f} m"


def lengths(evaluation: Evaluation) -> str:
    """Which lengths KITTI's errors are over, and why."""
    own = f"a segment begins at every {evaluation.every}th frame, as in KITTI's benchmark"
    short = "no 100 m driven: shorter lengths than KITTI's; a segment begins at every frame"
    return own if evaluation.every > 1 else short


def runs(evaluations: Sequence[Evaluation], names: Mapping[str, str]) -> TextTable:
    """How much of each of several runs the figures are over, and how they came about.

    Args:
        evaluations: of the runs.
        names: what each run is called in the table.
    """
    headers = ("frames", "both %", "lost", "driven m", "scale", "KITTI over")
    rows = tuple(row(names[item.run.name], *_overview(item)) for item in evaluations)
    return TextTable("Run", headers, rows, last_is_text=True, label_columns=20)


def _overview(evaluation: Evaluation) -> list[str]:
    run = evaluation.run
    counts = [str(run.frames), percent(run.coverage), str(run.lost), f"{evaluation.driven_m:.1f}"]
    return [*counts, _scale(evaluation.scales), _used_lengths(evaluation.stretches)]


def _scale(scales: Sequence[float]) -> str:
    least, most = (f"{scale:.4g}" for scale in (min(scales), max(scales)))
    return least if least == most else f"{least} to {most}"


def side_by_side(evaluations: Sequence[Evaluation], names: Mapping[str, str]) -> TextTable:
    """A row of figures for each of several runs.

    Args:
        evaluations: of the runs.
        names: what each run is called in the table.
    """
    headers = ("align", "ATE m", "RPE m", "RPE deg", "KITTI %", "deg/100 m", "segments")
    rows = tuple(row(names[item.run.name], *_figures(item)) for item in evaluations)
    return TextTable("RMSE", headers, rows, (_rpe(evaluations[0].delta),), label_columns=20)


def _figures(evaluation: Evaluation) -> list[str]:
    found = (evaluation.absolute_m, evaluation.relative_m, evaluation.relative_deg)
    rmse = [_number(statistics.rmse if statistics else None) for statistics in found]
    together = evaluation.together
    return [evaluation.alignment, *rmse, *_segment_cells(together), str(together.count)]


def _rpe(delta: Delta) -> str:
    return f"RPE over {delta_text(delta)}"


def delta_text(delta: Delta) -> str:
    """How far apart the poses of a pair are."""
    if delta.unit == "metres":
        return f"{delta.size:g} m"
    return number(int(delta.size), "frame")


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
