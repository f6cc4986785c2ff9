"""The short report: coverage, error and worst frame of each stage, as a table, as lines, and for other programs."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from roadperc_stream.output.reason_counts import ranked as ranked_reasons
from roadperc_stream.output.text_table import TextTable, row
from roadperc_stream.schemas.columns import UNITLESS

from .machine import Case
from .quantities import COVERED, NUMBERS, QUALITY, TOTAL, Quantity, percent, rounded
from .summary import Summary, WorstFrame

Command = Callable[[WorstFrame], str]
"""The command that shows a frame."""
LISTED: Final = 10
"""Most rows of the short tables with a row for each configuration or slice: the worst ones."""
RUNS_SHOWN: Final = 6
"""Most runs in the short report of several runs, which has at most 15 lines."""
NO_TRUTH: Final = "No frame has truth: the figures are the stages' own quality numbers, not errors."
_KNOWN: Final = {quantity.column: quantity for quantity in (*NUMBERS, *QUALITY)}
_STAGES: Final = {
    "surface": ("surface", "surface_height_error_m", "surface_inlier_ratio", "surface"),
    "lane left": ("left", "lane_left_error_m", "lane_left_second_difference_m", "lanes"),
    "lane right": ("right", "lane_right_error_m", "lane_right_second_difference_m", "lanes"),
    "objects": ("objects", "object_distance_error_m", "detections_kept", "objects"),
    "stereo": ("stereo", "stereo_epe_px", "stereo_valid_ratio", "stereo"),
    "odometry": ("odometry", "step_error_m", "odometry_inliers", "odometry"),
}
"""By stage: its output in ``COVERED``, the column of its error, that of its quality, and its name in reasons."""
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

    ``tail`` is p95 of the absolute values, or p5 if high is better. ``worst`` is the worst value, in the frame ``at``
    if that is known. All are None without values; ``reason`` then says why.
    """

    stage: str
    coverage: float
    quantity: Quantity
    median: float | None = None
    tail: float | None = None
    worst: float | None = None
    at: WorstFrame | None = None
    reason: str = ""

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
        return names | (known | frame if self.median is not None else {"reason": self.reason})


def stage_figures(summary: Summary, *, truth: bool) -> tuple[StageFigures, ...]:
    """The figures of each stage with a value or a reason in any frame: errors with ``truth``, else quality."""
    figures = (_figures(summary, stage, truth=truth) for stage in _STAGES)
    return tuple(found for found in figures if found.coverage > 0 or found.median is not None or found.reason)


def _figures(summary: Summary, stage: str, *, truth: bool) -> StageFigures:
    output, error, quality, source = _STAGES[stage]
    quantity = _KNOWN[error if truth else quality]
    coverage = summary.coverage(COVERED[output])
    found = summary.statistics.get(quantity.column)
    if found is None:
        texts = (str(reason) for reason in ranked_reasons(summary.reasons).values())
        reason = next((text for text in texts if text.startswith(f"{source}: ")), "")
        without = "no estimate has truth" if coverage else ""
        return StageFigures(stage, coverage, quantity, reason=without or reason.removeprefix(f"{source}: "))
    at = next(iter(summary.worst.get(quantity.column, ())), None)
    high = quantity.better == "high"
    most = (abs(at.value) if at else found.abs_most) if not high else at.value if at else found.least
    tail = found.p5 if high else found.abs_p95
    return StageFigures(stage, coverage, quantity, found.abs_median, tail, most, at)


def has_truth(summaries: Iterable[Summary]) -> bool:
    """Whether any stage has an error against truth."""
    return any(error in summary.statistics for summary in summaries for _, error, _, _ in _STAGES.values())


def stage_table(figures: Sequence[StageFigures], *, truth: bool) -> TextTable:
    """A row for each stage."""
    rows = (
        row(f.label, percent(f.coverage), *_cells(f), str(f.at.frame) if f.at else "")
        if f.median is not None
        else row(f.stage, percent(f.coverage))
        for f in figures
    )
    without = "; ".join(f"{f.stage}: {f.reason}" for f in figures if f.median is None and f.reason)
    notes = (without,) if without else ()
    headers = ("frames %", "median", "p95" if truth else "p95 or p5", "worst", "frame")
    return TextTable("Stage and error" if truth else "Stage and quality", headers, tuple(rows), notes)


def _cells(found: StageFigures) -> list[str]:
    values = (found.median, found.tail, found.worst)
    return ["" if value is None else rounded(value, found.quantity) for value in values]


def worst_of(figures: Iterable[StageFigures]) -> StageFigures | None:
    """The stage whose worst frame is the largest multiple of its limit; without limits the first with a frame."""
    having = [found for found in figures if found.at and found.worst is not None]
    return max(having, key=lambda found: abs(found.worst or 0.0) / (found.quantity.limit or 1e99), default=None)


def with_unit(value: float, quantity: Quantity) -> str:
    """A quantity's name and a value of it with its unit."""
    return f"{quantity.name} {rounded(value, quantity)}{'' if quantity.unit in UNITLESS else f' {quantity.unit}'}"


def worst_line(found: StageFigures, command: str) -> str:
    """The worst frame of a stage and the command that shows it."""
    return f"worst frame: {with_unit(abs(found.worst or 0.0), found.quantity)}: {command}"


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


def rows_tables(title: str, summaries: Sequence[Summary], *, of_runs: bool = False) -> tuple[TextTable, ...]:
    """Two tables with a row for each summary, the worst first: the tails of the stages' errors, and the coverage.

    For the short report ``of_runs``, one table: fewer rows, and the least coverage of any run as the last one.
    """
    truth = has_truth(summaries)
    found = {summary.name: {f.stage: f for f in stage_figures(summary, truth=truth)} for summary in summaries}
    stages = [stage for stage in _STAGES if any(stage in figures for figures in found.values())]
    ordered = sorted(summaries, key=lambda summary: -max((f.badness for f in found[summary.name].values()), default=0))
    shown = ordered[: RUNS_SHOWN if of_runs else LISTED]
    units = {stage: _KNOWN[_STAGES[stage][1 if truth else 2]] for stage in stages}
    headers = [f"{_NARROW.get(stage, stage)}{'' if q.unit in UNITLESS else f' {q.unit}'}" for stage, q in units.items()]
    tails, covered = [], []
    for s in shown:
        of_stages = [found[s.name].get(stage) for stage in stages]
        tails.append(row(s.name, str(s.frames), *(_cells(f)[1] if f else "" for f in of_stages)))
        covered.append(row(s.name, *(percent(f.coverage) if f else "" for f in of_stages)))
    if len(covered) > 1 and len({item.cells for item in covered}) == 1:
        covered = [replace(covered[0], label="each row")]
    notes = (f"listed: the worst {len(shown)} of {len(summaries)}",) if len(summaries) > len(shown) else ()
    kinds = "p95 error" if truth else "p95 or p5"
    if of_runs:
        least = (min(of_run[stage].coverage for of_run in found.values() if stage in of_run) for stage in stages)
        rows = (*tails, row("least coverage, %", "", *map(percent, least)))
        return (TextTable(f"{title}: {kinds}", ("frames", *headers), rows, label_columns=15),)
    return (
        TextTable(f"{title}: {kinds}", ("frames", *headers), tuple(tails), notes, label_columns=15),
        TextTable("Coverage, %", tuple(_NARROW.get(s, s) for s in stages), tuple(covered), label_columns=15),
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
