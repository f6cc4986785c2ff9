"""Prints errors of runs' trajectories against truth, and exports them for other tools."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from roadperc_stream.errors import TableError
from roadperc_stream.output.terminal import console_for
from roadperc_stream.output.text_table import Table
from roadperc_stream.system.text import listed, number

from ..continued import find_joined
from ..options import Alignment
from ..report_columns import legend, name_columns, percent, short_names
from ..results import Case, ResultFiles, Results
from ..runs import Run
from .errors import Delta, ErrorStatistics
from .evaluation import Evaluation, Segments, evaluate
from .poses import PoseFormat, RunPoses, export, read_poses

_ALIGNED: Final[Mapping[Alignment, str]] = {
    "se3": "aligned by SE(3)",
    "sim3": "aligned by Sim(3)",
    "origin": "first pose on the first true one",
    "none": "not aligned",
}

_EACH: Final = ", each segment of the log separately"


def trajectories(
    names: Sequence[str],
    alignment: Alignment | None,
    delta: Delta,
    exports: Mapping[PoseFormat, Path],
    files: ResultFiles,
) -> None:
    """Print the errors of runs' trajectories, write them to files for other programs, and export the poses.

    ``exports`` are the folders of the poses in each format.
    A line names each run without a trajectory; it is an error if no run has one.

    Raises:
        TableError: an argument names no run, or no run has a trajectory.
        TargetError: a file cannot be written.
    """
    found = find_joined(names)
    evaluated: list[Evaluation] = []
    refused: dict[str, TableError] = {}
    exported = False
    for item in found.runs:
        try:
            poses = read_poses(item)
            for kind, folder in exports.items():
                export(folder, poses, kind)
                exported = True
            evaluated.append(evaluate(poses, alignment, delta))
        except TableError as error:
            refused[item.name] = error
    if not evaluated and not exported:
        raise next(iter(refused.values()))
    console = console_for(sys.stdout)
    skipped = {name: str(error) for name, error in refused.items()}
    short = short_names([item.run.name for item in evaluated], name_columns(console))
    results = _results(evaluated, (*found.notes, *skipped.values()), short)
    cases = [*results.cases, *(Case(name, "trajectory", "skipped", error) for name, error in skipped.items())]
    results = replace(results, values={**results.values, "skipped": skipped}, cases=cases)
    results.write(files)
    results.print(console)


def _results(evaluated: Sequence[Evaluation], notes: Sequence[str], names: Mapping[str, str]) -> Results:
    """The statistics of one run, or a row for each of several; ``notes`` come first, ``names`` are short."""
    values = {"runs": {item.run.name: _as_json(item) for item in evaluated}}
    cases = [Case(item.run.name, "trajectory", "passed", _body(item)) for item in evaluated]
    head, tail, tables = [*notes], list[str](), list[Table]()
    if len(evaluated) == 1:
        head += _facts(evaluated[0])
        tables = [_error_table(evaluated[0]), _stretch_table(evaluated[0])]
    elif evaluated:
        head.append(f"{len(evaluated)} runs")
        tables = [_run_table(evaluated, names), _side_by_side(evaluated, names)]
        tail = [f"{item.run.name}: {note}" for item in evaluated for note in _notes(item)]
    return Results("trajectory", "Trajectories", head, tables, tail, values, cases)


def in_short(run: Run) -> tuple[tuple[str, ...], dict[str, Any]]:
    """The errors of a run's trajectory in a line and for other programs; both are empty without poses to compare."""
    try:
        found = evaluate(read_poses(run), None, Delta(1, "frames"))
    except TableError:
        return (), {}
    line = f"trajectory: ATE {_number(found.absolute_m.rmse)} m, {_ALIGNED[found.alignment]}"
    if lengths := [stretch.length_m or 0 for stretch in found.stretches if stretch.count]:
        percent_off, deg_off = _segment_cells(found.together)
        ends = dict.fromkeys(f"{length:.0f}" for length in (lengths[0], lengths[-1]))
        line += f", KITTI t_err {percent_off} %, r_err {deg_off} deg/100 m over {' to '.join(ends)} m"
    line = "; ".join(filter(None, (line, _without_scale(found))))
    return (line,), {"trajectory": _as_json(found)}


def _as_json(item: Evaluation) -> dict[str, Any]:
    errors = {"ate_m": item.absolute_m, "rpe_m": item.relative_m, "rpe_deg": item.relative_deg}
    return {
        "alignment": item.alignment,
        "frames": item.run.frames,
        "coverage": item.run.coverage,
        "lost": item.run.lost,
        "driven_m": item.driven_m,
        **{name: vars(found) for name, found in errors.items() if found is not None},
        "kitti": {key: value for key, value in vars(item.together).items() if value is not None},
    }


def _body(item: Evaluation) -> str:
    table = _side_by_side([item], {item.run.name: item.run.name})
    return ", ".join(f"{name} {cell}" for name, cell in zip(table.headers, table.rows[0][1:], strict=True) if cell)


def _facts(evaluation: Evaluation) -> Iterator[str]:
    """What was evaluated, and how it was aligned."""
    run, segments = evaluation.run, _in_segments(evaluation.run)
    scales = listed([f"{scale:.6g}" for scale in evaluation.scales])
    scaled = f", the estimate scaled by {scales}" if evaluation.alignment == "sim3" else ""
    counts = f"estimated {run.estimated_frames}, true {run.true_frames}, lost {run.lost}"
    yield f"{run.name}: {run.frames} frames{segments}, {evaluation.driven_m:.1f} m driven"
    yield f"{percent(run.coverage)} % have both poses: {counts}"
    yield f"{_ALIGNED[evaluation.alignment]}{_EACH if segments else ''}{scaled}"
    yield from filter(None, (*evaluation.left_out, _without_scale(evaluation)))


def _notes(evaluation: Evaluation) -> Iterator[str]:
    """Notes on one of several runs."""
    found = _in_segments(evaluation.run)
    segments = f"{evaluation.run.frames} frames{found}{_EACH}" if found else ""
    yield from filter(None, (segments, *evaluation.left_out, _without_scale(evaluation)))


def _in_segments(run: RunPoses) -> str:
    """The number of segments with poses, if there are several."""
    segments = len(run.of_segments)
    return f" in {segments} segments of the log" if segments > 1 else ""


def _without_scale(evaluation: Evaluation) -> str:
    """A note on steps without scale; empty if all steps have a scale."""
    run = evaluation.run
    counted = f"{run.without_scale} of {run.steps} steps have no scale"
    if run.up_to_scale:
        hint = "" if evaluation.alignment == "sim3" else "; pass --align sim3"
        return f"up to scale ({counted}): only errors aligned by Sim(3) are meaningful{hint}"
    return f"{counted}; their frames have no pose" if run.without_scale else ""


def _error_table(evaluation: Evaluation) -> Table:
    """Absolute and relative errors."""
    rows = (
        ("ATE, m", *_cells(evaluation.absolute_m)),
        ("RPE, m", *_cells(evaluation.relative_m)),
        ("RPE, deg", *_cells(evaluation.relative_deg)),
    )
    headers = ("values", "RMSE", "mean", "median", "std", "min", "max", "SSE")
    return Table("Error", headers, rows, (_rpe(evaluation.delta),), label_columns=22)


def _stretch_table(evaluation: Evaluation) -> Table:
    """KITTI's errors by length, empty for lengths without stretches."""
    segments = (*evaluation.stretches, evaluation.together)
    rows = tuple(
        ("all" if item.length_m is None else f"{item.length_m:.0f} m", str(item.count), *_segment_cells(item))
        for item in segments
    )
    headers = ("segments", "translation %", "rotation deg/100 m")
    long = f"a segment begins at every {evaluation.every}th frame, as in KITTI's benchmark"
    short = "less than 100 m driven: shorter lengths, a segment begins at every frame"
    return Table("KITTI", headers, rows, (long if evaluation.every > 1 else short,))


def _run_table(evaluations: Sequence[Evaluation], names: Mapping[str, str]) -> Table:
    """A row for each run: evaluated frames, smallest and largest scale, and lengths with stretches."""
    rows = []
    for item in evaluations:
        counts = str(item.run.frames), percent(item.run.coverage), str(item.run.lost), f"{item.driven_m:.1f}"
        least, most = (f"{scale:.4g}" for scale in (min(item.scales), max(item.scales)))
        used = [f"{segments.length_m:.0f}" for segments in item.stretches if segments.length_m and segments.count]
        lengths = f"{', '.join(used)} m" if used else "no length"
        rows.append((names[item.run.name], *counts, least if least == most else f"{least} to {most}", lengths))
    headers = ("frames", "both %", "lost", "driven m", "scale", "KITTI over")
    return Table("Run", headers, tuple(rows), tuple(legend(names)), last_is_text=True, label_columns=20)


def _side_by_side(evaluations: Sequence[Evaluation], names: Mapping[str, str]) -> Table:
    """A row of errors for each run."""
    rows = []
    for item in evaluations:
        found = (item.absolute_m, item.relative_m, item.relative_deg)
        rmse = [_number(statistics.rmse if statistics else None) for statistics in found]
        kitti = (*_segment_cells(item.together), str(item.together.count))
        rows.append((names[item.run.name], item.alignment, *rmse, *kitti))
    headers = ("align", "ATE m", "RPE m", "RPE deg", "KITTI %", "deg/100 m", "segments")
    return Table("RMSE", headers, tuple(rows), (_rpe(evaluations[0].delta),), label_columns=20)


def _rpe(delta: Delta) -> str:
    """The distance between the poses of a pair."""
    return f"RPE over {f'{delta.size:g} m' if delta.unit == 'metres' else number(int(delta.size), 'frame')}"


def _segment_cells(segments: Segments) -> list[str]:
    return [_number(value) for value in (segments.translation_percent, segments.rotation_deg_per_100m)]


def _cells(found: ErrorStatistics | None) -> list[str]:
    if found is None:
        return ["0"]
    values = (found.rmse, found.mean, found.median, found.std, found.least, found.most, found.sse)
    return [str(found.count), *(_number(value) for value in values)]


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:z.4f}"
