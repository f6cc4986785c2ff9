"""The short report: coverage, error and worst frame of each stage, as a table, as lines, and for other programs."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

from roadperc_stream.output.reason_counts import ranked as ranked_reasons
from roadperc_stream.output.text_table import Row, Table, rows_of_subjects
from roadperc_stream.schemas.columns import UNITLESS, FrameMetrics
from roadperc_stream.schemas.columns.hindsight import FRAME_HINDSIGHT

from ..report_columns import COVERED, NUMBERS, QUALITY, SPEED, TOTAL, TRUTH_OF, Quantity, percent, rounded, with_unit
from ..results import Case
from .summaries import Columns, Summary, WorstFrame

Command = Callable[[WorstFrame], str]
"""The command that shows a frame."""
LISTED: Final = 10
"""Most rows of the short tables with a row for each configuration or slice: the worst ones."""
RUNS_SHOWN: Final = 6
"""Most runs in the short report of several runs, which has at most 15 lines."""
NO_TRUTH: Final = "No frame has truth: the figures are the stages' own quality numbers, not errors."
BY_HINDSIGHT: Final = "No frame has truth: the errors are by hindsight, against what later frames found."
_ANSWERED: Final = "frames with an error by hindsight, %"
_STORED: Final = frozenset((*(column.name for column in fields(FrameMetrics)), *FRAME_HINDSIGHT))
_KNOWN: Final = {quantity.column: quantity for quantity in (*NUMBERS, *QUALITY)}


@dataclass(frozen=True)
class _Stage:
    """Where the figures of a stage come from.

    ``output`` is its output in ``COVERED``, ``error`` the column of its error and ``quality`` that of its quality.
    ``telling`` is a column that shows without truth whether the scale is right. ``source`` is its name in reasons.
    ``status`` is a text column; frames with one of its ``states`` have a row each.
    """

    output: str
    error: str
    quality: str
    telling: str
    source: str
    status: str
    states: tuple[str, ...] = ("held",)

    @property
    def errors(self) -> tuple[str, ...]:
        """The columns of its error: against truth, and by hindsight if there is one."""
        return (self.error, *(name for name, truth in TRUTH_OF.items() if truth == self.error))


_HEIGHT: Final = "camera_height_m"
_STAGES: Final = {
    "surface": _Stage(
        *("surface", "surface_height_error_m", "surface_inlier_ratio", _HEIGHT, "surface", "surface_source"),
        ("held", "estimated", "assumed"),
    ),
    "lane left": _Stage(
        *("left", "lane_left_error_m", "lane_left_second_difference_m", "", "lanes", "lane_left_status")
    ),
    "lane right": _Stage(
        *("right", "lane_right_error_m", "lane_right_second_difference_m", "lane_width_m", "lanes"), "lane_right_status"
    ),
    "objects": _Stage("objects", "object_distance_error_m", "detections_kept", "", "objects", "", ()),
    "stereo": _Stage("stereo", "stereo_epe_px", "stereo_valid_ratio", "", "stereo", "", ()),
    "odometry": _Stage(
        *("odometry", "step_error_m", "odometry_inliers", SPEED.column, "odometry", "odometry_status"), ("lost",)
    ),
}
TRUE_POSES: Final = "turn_error_deg"
"""A column with values if the log has true poses."""
COLUMNS: Final = Columns(
    frozenset((*(of.error for of in _STAGES.values()), _HEIGHT, TRUE_POSES, TOTAL.column)),
    counted=(*COVERED.values(), "step_m"),
    instead={
        column: of.error for of in _STAGES.values() for column in (*of.errors[1:], of.quality, of.telling) if column
    },
)
"""The numeric columns of the short report: errors by hindsight and quality only of stages without errors by truth."""
NO_SCALE: Final = "without metric scale"
_ASSUMED: Final = "the assumed height"
_NARROW: Final = {
    "surface": "surf.",
    "objects": "obj.",
    "lane left": "left",
    "lane right": "right",
    "odometry": "odom.",
}
"""Short headers for wide tables."""


@dataclass(frozen=True)
class StageFigures:
    """The coverage of a stage as a ratio, and the statistics of its error, or of its quality without truth.

    Coverage counts what was measured; ``states`` has the shares of the other frames, by state. ``tail`` is p95 of the
    absolute values, or p5 if high is better. ``worst`` is the worst value, in the frame ``at`` if that is known. All
    are None without values; ``reason`` then says why. ``reason`` also says why frames are lost. ``telling`` are the
    figures of a value that shows without truth whether the scale is right.
    """

    stage: str
    coverage: float
    quantity: Quantity
    median: float | None = None
    tail: float | None = None
    worst: float | None = None
    at: WorstFrame | None = None
    reason: str = ""
    states: Mapping[str, float] = field(default_factory=dict)
    telling: "StageFigures | None" = None
    answered: float | None = None
    """Share of the frames with an error by hindsight; None for other figures."""

    @property
    def badness(self) -> float:
        """The tail as a multiple of the limit of the error; 0 if unknown."""
        return abs(self.tail or 0.0) / (self.quantity.limit or float("inf"))

    @property
    def label(self) -> str:
        """The stage and the quantity, with its unit."""
        names_it = self.quantity.name.startswith(self.stage.removesuffix("s"))
        return self.quantity.label if names_it else f"{self.stage}: {self.quantity.label}"

    @property
    def tail_name(self) -> str:
        """Name of the tail's quantile."""
        return "p5" if self.quantity.better == "high" else "p95"

    def as_mapping(self, command: Command) -> dict[str, Any]:
        """The figures for other programs."""
        known = {"median": self.median, self.tail_name: self.tail, "worst": self.worst}
        frame = {"worst_frame": self.at.frame, "command": command(self.at)} if self.at else {}
        names = {"coverage": self.coverage, "column": self.quantity.column, "unit": self.quantity.unit}
        more: dict[str, Any] = {"states": dict(self.states)} if self.states else {}
        if self.answered is not None:
            more["answered"] = self.answered
        if self.telling is not None:
            more[self.telling.quantity.column] = {"coverage": self.telling.coverage, "median": self.telling.median}
        return names | (known | frame if self.median is not None else {"reason": self.reason}) | more


def judged_stages(summaries: Iterable[Summary]) -> dict[str, str]:
    """The stages that have an error in any summary, and its column: against truth, else by hindsight."""
    found = {column for summary in summaries for column in summary.statistics}
    errors = {stage: [name for name in of.errors if name in found] for stage, of in _STAGES.items()}
    return {stage: names[0] for stage, names in errors.items() if names}


def stage_figures(summary: Summary, judged: Mapping[str, str]) -> tuple[StageFigures, ...]:
    """The figures of each stage with a value or a reason in any frame: the errors ``judged``, else its quality."""
    figures = (_figures(summary, stage, judged.get(stage)) for stage in _STAGES)
    return tuple(found for found in figures if found.coverage > 0 or found.median is not None or found.reason)


def _figures(summary: Summary, stage: str, error: str | None) -> StageFigures:
    of = _STAGES[stage]
    quantity = _KNOWN[error or of.quality]
    states = _states(summary, of)
    figures = StageFigures(
        stage,
        summary.coverage(COVERED[of.output]),
        quantity,
        reason=_reason(summary, of) if quantity.column not in summary.statistics or "lost" in states else "",
        states=states,
        telling=None if error == of.error else _telling(summary, of),
        answered=summary.coverage(quantity.column) if quantity.column in TRUTH_OF else None,
    )
    found = summary.statistics.get(quantity.column)
    if found is None:
        return figures
    at = next(iter(summary.worst.get(quantity.column, ())), None)
    high = quantity.better == "high"
    most = (abs(at.value) if at else found.abs_most) if not high else at.value if at else found.least
    return replace(figures, median=found.abs_median, tail=found.p5 if high else found.abs_p95, worst=most, at=at)


def _states(summary: Summary, of: _Stage) -> dict[str, float]:
    """The shares of the frames whose output was not measured, or has no scale."""
    shares = {state: summary.share(of.status, state) for state in of.states}
    if of.source == "odometry":
        shares[NO_SCALE] = summary.coverage(COVERED[of.output]) - summary.coverage("step_m")
    return {state: share for state, share in shares.items() if share > 0}


def _reason(summary: Summary, of: _Stage) -> str:
    found = ranked_reasons(summary.reasons).values()
    return next((count.text for count in found if count.reason.source == of.source), "")


def _telling(summary: Summary, of: _Stage) -> StageFigures | None:
    found = summary.statistics.get(of.telling)
    if found is None or not summary.coverage(COVERED[of.output]):
        return None
    quantity, mounting_m = _KNOWN[of.telling], summary.mounting_height_m
    if quantity.column == _HEIGHT and mounting_m is not None:
        quantity = replace(quantity, name=f"{quantity.name} (mounting {mounting_m:.3f})")
    return StageFigures("", summary.coverage(of.telling), quantity, found.median, found.p95)


def assumed_height(summary: Summary) -> str:
    """The line on an assumed camera height; empty if the log or depth gave the height of every frame."""
    height, assumed = summary.statistics.get(_HEIGHT), any(_ASSUMED in kind[0] for kind in summary.reasons)
    if height is None or not assumed:
        return ""
    return f"assumed height {height.median:g} m, because the log has no mounting; pass --height to roadperc-replay"


def stages_of(summaries: Sequence[Summary]) -> Table:
    """The table of the stages of one summary, or of several side by side."""
    judged = judged_stages(summaries)
    return stage_table({summary.name: stage_figures(summary, judged) for summary in summaries}, judged)


def stage_table(figures: Mapping[str, Sequence[StageFigures]], judged: Mapping[str, str]) -> Table:
    """A row for each stage, then a row for each state of its frames, and for the value that tells its scale.

    ``figures`` are those of each subject, by its name.
    """
    of_stages = [f for stage in _STAGES for found in figures.values() for f in found if f.stage == stage]
    names = [name for stage in _STAGES for name, found in figures.items() for f in found if f.stage == stage]
    cells: dict[str, dict[str, tuple[str, ...]]] = {}
    about: dict[str, str] = {}
    for name, found in zip(names, of_stages, strict=True):
        for label, column, line in _rows(found):
            cells.setdefault(label, {})[name] = line
            about |= {label: column} if column else {}
    rows = rows_of_subjects(cells, len(figures) > 1)
    shown = [f for f in of_stages if f.median is not None]
    figured = [f for found in of_stages for f in (found, found.telling) if f and f.median is not None]
    columns = dict.fromkeys(f.quantity.column for f in figured if f.quantity.column in _STORED)
    whole = [f"{f.stage}: {f.reason}" for f in of_stages if f.reason]
    apart = dict.fromkeys(f.stage for f in shown if f.stage not in judged)
    all_apart = len(apart) == len({f.stage for f in shown})
    notes = [f"no truth, the stage's own quality: {', '.join(apart)}"] if apart and not all_apart else []
    notes += ["; ".join(whole)] if whole and len(figures) == 1 else []
    answered = [f"{f.stage} {percent(f.answered)}" for f in shown if f.answered is not None]
    notes += [f"{_ANSWERED}: {', '.join(answered)}"] if answered and len(figures) == 1 else []
    notes += [f"columns: {', '.join(columns)}"] if columns else []
    title = "quality" if all_apart else "error or quality" if apart else "error"
    tail = "p95 or p5" if any(f.tail_name == "p5" for f in shown) else "p95"
    headers = ("frames %", "median", tail, "worst", *(["frame"] if any(f.at for f in shown) else []))
    return Table(f"Stage and {title}", headers, rows, notes, about)


def _rows(found: StageFigures) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Label, column and cells of the rows of a stage."""
    if found.median is None:
        yield found.stage, "", (percent(found.coverage),)
    else:
        frame = [str(found.at.frame)] if found.at else []
        yield found.label, found.quantity.column, (percent(found.coverage), *_cells(found), *frame)
    for state, share in found.states.items():
        yield f"{found.stage}: {state}", "", (percent(share),)
    if told := found.telling:
        yield told.quantity.label, told.quantity.column, (percent(told.coverage), *_cells(told)[:2])


def _cells(found: StageFigures) -> list[str]:
    values = (found.median, found.tail, found.worst)
    return ["" if value is None else rounded(value, found.quantity) for value in values]


def worst_of(figures: Iterable[StageFigures]) -> StageFigures | None:
    """The stage whose worst frame is the largest multiple of its limit; without limits the first with a frame."""
    having = [found for found in figures if found.at and found.worst is not None]
    return max(having, key=lambda found: abs(found.worst or 0.0) / (found.quantity.limit or math.inf), default=None)


def worst_line(found: StageFigures, command: str) -> str:
    """The worst frame of a stage and the command that shows it."""
    return f"worst frame: {found.quantity.name} {with_unit(abs(found.worst or 0.0), found.quantity)}: {command}"


def latency_line(summary: Summary) -> str:
    """Median and p95 of the time of a frame, and the speed of one core."""
    found = latency(summary)
    times = f"latency: median {found['median_ms']:.1f} ms, p95 {found['p95_ms']:.1f} ms"
    return f"{times}, {found['frames_per_core_s']:.1f} frames/s per core"


def latency(summary: Summary) -> dict[str, float]:
    """Median and p95 of the time of a frame in ms, and the frames per second of one core."""
    total = summary.statistics[TOTAL.column]
    rate = 1000 * total.values / total.total if total.total > 0 else 0.0
    return {"median_ms": total.median, "p95_ms": total.p95, "frames_per_core_s": rate}


def rows_tables(title: str, summaries: Sequence[Summary], *, of_runs: bool = False) -> tuple[Table, ...]:
    """Two tables with a row for each summary, the worst first: the tails of the stages' errors, and the coverage.

    For the short report ``of_runs``, one table: fewer rows, and the least coverage of any run as the last one.
    """
    judged = judged_stages(summaries)
    found = {summary.name: {f.stage: f for f in stage_figures(summary, judged)} for summary in summaries}
    stages = [stage for stage in _STAGES if any(stage in figures for figures in found.values())]
    ordered = sorted(summaries, key=lambda summary: -max((f.badness for f in found[summary.name].values()), default=0))
    shown = ordered[: RUNS_SHOWN if of_runs else LISTED]
    units = {stage: _KNOWN[judged.get(stage, _STAGES[stage].quality)] for stage in stages}
    headers = [f"{_NARROW.get(stage, stage)}{'' if q.unit in UNITLESS else f' {q.unit}'}" for stage, q in units.items()]
    tails: list[Row] = []
    covered: list[Row] = []
    for s in shown:
        of_stages = [found[s.name].get(stage) for stage in stages]
        tails.append((s.name, str(s.frames), *(_cells(f)[1] if f else "" for f in of_stages)))
        covered.append((s.name, *(percent(f.coverage) if f else "" for f in of_stages)))
    if len(covered) > 1 and len({row[1:] for row in covered}) == 1:
        covered = [("each row", *covered[0][1:])]
    notes = (f"listed: the worst {len(shown)} of {len(summaries)}",) if len(summaries) > len(shown) else ()
    kinds = "p95 error" if judged.keys() >= {*stages} else "p95 or p5"
    columns = f"columns: {', '.join(q.column for q in units.values())}"
    notes = (*notes, columns)
    if of_runs:
        least = (min(of_run[stage].coverage for of_run in found.values() if stage in of_run) for stage in stages)
        rows = (*tails, ("least coverage, %", "", *map(percent, least)))
        return (Table(f"{title}: {kinds}", ("frames", *headers), rows, (columns,), label_columns=15),)
    return (
        Table(f"{title}: {kinds}", ("frames", *headers), tuple(tails), notes, label_columns=15),
        Table("Coverage, %", tuple(_NARROW.get(s, s) for s in stages), tuple(covered), label_columns=15),
    )


def values_of(summary: Summary, figures: Sequence[StageFigures], command: Command) -> dict[str, Any]:
    """The figures of a summary for other programs."""
    return {
        "frames": summary.frames,
        "logs": len(summary.log_ids),
        "seconds": summary.span_s,
        "latency": latency(summary),
        "stages": {found.stage.replace(" ", "_"): found.as_mapping(command) for found in figures},
    }


def cases_of(name: str, figures: Sequence[StageFigures]) -> Iterator[Case]:
    """A case for each stage of the summary ``name``, skipped without a value."""
    for found in figures:
        median, tail, worst = _cells(found)
        text = f"{found.label}: median {median}, {found.tail_name} {tail}, worst {worst}"
        without = found.reason or "no value"
        yield Case(name, found.stage, *(("passed", text) if median else ("skipped", without)))
