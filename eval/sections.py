"""The tables and lines of a report, as rich renderables: what a perception engineer asks, in that order."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Final

from rich.table import Table

from roadperc_stream.cli.terminal import grid
from roadperc_stream.core.reasons import ReasonCount, ranked

from .grid import percent, rounded
from .quantities import CATEGORIES, SEEN, SIDES, SKEW, STAGES, STORED, SUSPECT, TOTAL, TRUTH, Quantity
from .summary import Summary, WorstFrame

REASONS_SHOWN: Final = 10


def identity(summary: Summary) -> str:
    """Which log, made by which configuration and version."""
    if summary.runs > 1:
        facts = [(summary.log_ids, "log"), (summary.configs, "configuration"), (summary.versions, "version")]
        counts = ", ".join(f"{len(names)} {what}{'s' * (len(names) > 1)}" for names, what in facts)
        return f"{summary.runs} runs: {counts}"
    config, version = summary.configs[0][:8] or "unknown", summary.versions[0] or "unknown"
    return f"{summary.name}: log {', '.join(summary.log_ids)}, configuration {config}, version {version}"


def extent(summary: Summary) -> str:
    """How many frames over how long."""
    frames = f"{summary.frames} frame{'s' * (summary.frames > 1)}"
    if summary.rate_hz is None:
        return frames
    return (
        f"{frames} over {summary.span_s:.2f} s, {summary.rate_hz:.1f} a second, "
        f"longest gap {summary.longest_gap_s:.2f} s"
    )


def inputs(summary: Summary) -> str:
    """Whose messages were missing, usable or not, and how far apart the sensors' stamps lie."""
    if summary.incomplete:
        roles = ", ".join(f"{role} {percent(n / summary.frames)} %" for role, n in summary.missing.most_common())
        said = f"something missing in {percent(summary.incomplete / summary.frames)} % of the frames: {roles}"
    else:
        said = "no message missing in any frame"
    skew = summary.statistics.get(SKEW.column)
    return said if skew is None else f"{said}; sync skew median {skew.median:.1f} ms, p95 {skew.p95:.1f} ms"


def precision(summary: Summary) -> str:
    """How exact the quantiles are where not all values were at hand."""
    error = 100 * summary.rank_error
    return (
        f"quantiles over all {summary.frames} frames are within {error:.2f} % in rank, "
        f"those of absolute values within {2 * error:.2f} %"
    )


def seen(summary: Summary) -> Table:
    """Coverage and typical values of what needs no truth."""
    table = grid("Does it see?", "frames %", "p5", "median", "p95")
    for column, label in (("surface_source", "surface"), ("odometry_status", "odometry")):
        for value, number in summary.categories[column].most_common():
            table.add_row(f"{label}: {value}", percent(number / summary.frames))
    for quantity in SEEN:
        found = summary.statistics.get(quantity.column)
        if found is not None:
            values = (rounded(value, quantity) for value in (found.p5, found.median, found.p95))
            table.add_row(quantity.label, percent(summary.coverage(quantity.column)), *values)
    return table


def lane_boundaries(summary: Summary) -> Table:
    """Per side: how often measured, held or lost, where it lies, and how it trembles, smoothed and raw."""
    headers = ("measured %", "held %", "lost %", "offset m", "jitter cm", "raw cm", "lag")
    table = grid("Lane boundary", *headers, label_columns=13)
    if any(summary.categories[f"lane_{side}_status"] for side in SIDES):
        for side in SIDES:
            table.add_row(side, *boundary(summary, side))
    return table


def boundary(summary: Summary, side: str) -> list[str]:
    """Percent measured, held, lost; offset in m, jitter in cm smoothed and raw, lag in frames; empty where unknown."""
    states = [percent(summary.share(f"lane_{side}_status", state)) for state in ("measured", "held", "lost")]
    offset = summary.statistics.get(f"lane_{side}_offset_m")
    jitters = [summary.statistics.get(f"lane_{side}_{kind}second_difference_m") for kind in ("", "raw_")]
    lag = summary.lag_frames(side)
    return [
        *states,
        f"{offset.median:z.2f}" if offset else "",
        *(f"{100 * jitter.std:.2f}" if jitter else "" for jitter in jitters),
        "" if lag is None else str(lag),
    ]


def has_lag(summary: Summary) -> bool:
    """Whether it can be told how far any smoothed boundary lies behind the truth."""
    return any(summary.lag_frames(side) is not None for side in SIDES)


def beyond_lanes(summary: Summary) -> str:
    """What lies beyond the boundaries, in shares of the frames where that is known."""
    sides = [(side, summary.categories[f"lane_{side}_boundary_class"]) for side in SIDES]
    return "; ".join(
        f"beyond the {side}: "
        + ", ".join(f"{name} {number / classes.total():.0%}" for name, number in classes.most_common(3))
        for side, classes in sides
        if classes
    )


def has_truth(summary: Summary) -> bool:
    """Whether any frame could be held against truth."""
    return any(quantity.column in summary.statistics for quantity in TRUTH)


def no_values(summary: Summary) -> str:
    """The columns that are null in every frame, those of truth only where there is some."""
    timed = {quantity.column for quantity in STAGES}
    numeric = [q.column for q in STORED if q.column not in timed and (has_truth(summary) or q not in TRUTH)]
    present = {name for name in (*numeric, *CATEGORIES) if name in summary.statistics or summary.categories.get(name)}
    absent = [name for name in (*numeric, *CATEGORIES) if name not in present]
    return ", ".join(_collapsed(absent, present))


def right(summary: Summary) -> Table:
    """Accuracy beside coverage, an error being estimate minus truth."""
    table = accuracy_grid("Is it right?")
    for quantity in TRUTH:
        if quantity.column in summary.statistics:
            table.add_row(quantity.label, *accuracy(summary, quantity))
    return table


def counted(summary: Summary) -> Table:
    """Precision, recall and F1 from the counts of all frames, and the counts."""
    table = grid("How many of them?", "precision", "recall", "F1", "right", "wrong", "missed")
    for score in summary.scores:
        ratios = ("" if ratio is None else f"{ratio:.3f}" for ratio in (score.precision, score.recall, score.f1))
        table.add_row(score.name, *ratios, str(score.tp), str(score.fp), str(score.fn))
    return table


def speed(summary: Summary) -> str:
    """Frames a second, and how that compares with the log's own time."""
    total = summary.statistics.get(TOTAL.column)
    if total is None or total.total <= 0:
        return ""
    rate_hz = 1000 * total.values / total.total
    against = f", {rate_hz / summary.rate_hz:.1f} times real time" if summary.rate_hz else ""
    return f"{rate_hz:.1f} frames a second{against}"


def fast(summary: Summary) -> Table:
    """Time per stage."""
    table = speed_grid("How fast?")
    for quantity in STAGES:
        if quantity.column in summary.statistics:
            table.add_row(quantity.name, *times(summary, quantity))
    return table


def worst(summary: Summary) -> Table:
    """The worst frames by every error there is, else by signs of trouble that need no truth."""
    several = summary.runs > 1
    table = grid("Worst frames", "value", "frame", "s", "stamp ns", text="log" if several else "", label_columns=20)
    ranked = [q for q in TRUTH if q.column in summary.worst] or [q for q in SUSPECT if q.column in summary.worst]
    for quantity in ranked:
        for rank, frame in enumerate(summary.worst[quantity.column]):
            log = [frame.run] if several else []
            table.add_row(quantity.label if rank == 0 else "", *_worst_cells(frame, quantity), *log)
    return table


def reasons(summary: Summary) -> Table:
    """Why something is absent, as the chain put it, and in how many frames; of the rarest only how many there are."""
    table = reasons_grid("Why not?")
    found = list(ranked(summary.reasons).values())
    for reason in found[:REASONS_SHOWN]:
        table.add_row(str(reason), *given(reason, summary))
    rest = len(found) - REASONS_SHOWN
    if rest > 0:
        table.add_row(f"{rest} other reason{'s' * (rest > 1)}")
    return table


def reasons_grid(title: str) -> Table:
    """An empty table for rows of ``given``."""
    return grid(title, "frames", "frames %")


def given(reason: ReasonCount, summary: Summary) -> list[str]:
    """In how many frames a reason was given, and the share in percent."""
    return [str(reason.frames), percent(reason.frames / summary.frames)]


def accuracy_grid(title: str) -> Table:
    """An empty table for rows of ``accuracy``."""
    return grid(title, "frames %", "bias", "median", "p95", "worst")


def accuracy(summary: Summary, quantity: Quantity) -> list[str]:
    """Coverage, bias (median with its sign), then median, p95 and worst of the absolute error; p5 where low is bad."""
    found = summary.statistics[quantity.column]
    coverage = percent(summary.coverage(quantity.column))
    bias = rounded(found.median, quantity) if quantity.signed else ""
    if quantity.worse == "low":
        tail, most = f"p5 {rounded(found.p5, quantity)}", found.least
    else:
        tail, most = rounded(found.abs_p95, quantity), found.abs_most
    return [coverage, bias, rounded(found.abs_median, quantity), tail, rounded(most, quantity)]


def speed_grid(title: str) -> Table:
    """An empty table for rows of ``times``."""
    return grid(title, "median ms", "p95 ms", "p99 ms", "share %")


def times(summary: Summary, quantity: Quantity) -> list[str]:
    """Median, p95 and p99 in milliseconds, and the share of the total time in percent."""
    found, total = summary.statistics[quantity.column], summary.statistics[TOTAL.column]
    share = percent(found.total / total.total) if total.total > 0 else ""
    return [*(rounded(value, quantity) for value in (found.median, found.p95, found.p99)), share]


def _worst_cells(frame: WorstFrame, quantity: Quantity) -> list[str]:
    return [rounded(frame.value, quantity), str(frame.frame), f"{frame.since_start_s:.3f}", str(frame.stamp_ns)]


def _collapsed(absent: Sequence[str], present: Iterable[str]) -> list[str]:
    """Names that share their first word as ``word*``, unless a column that has values begins with it, too."""
    taken = {name.split("_")[0] for name in present}
    words = [name.split("_")[0] for name in absent]
    sizes = Counter(words)
    pairs = zip(absent, words, strict=True)
    return list(dict.fromkeys(f"{word}*" if sizes[word] > 1 and word not in taken else name for name, word in pairs))
