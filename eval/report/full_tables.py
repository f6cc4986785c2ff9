"""The tables of a report over one summary, or over several side by side."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, islice
from typing import Final

from roadperc_stream.model import ReasonKind
from roadperc_stream.output.reason_counts import merged
from roadperc_stream.output.reason_counts import ranked as ranked_reasons
from roadperc_stream.output.text_table import Row, Table, rows_of_subjects

from ..compare.bootstrap import LEVEL
from ..report_columns import (
    CATEGORIES,
    CONFUSED,
    COUNTED,
    ERRORS,
    SEEN,
    SIDES,
    STAGE_TIMES,
    STORED,
    TOTAL,
    TRUTH,
    Quantity,
    percent,
    ranked,
    rounded,
)
from .consistency import JUDGED
from .statistics import Statistics
from .summaries import BETWEEN, Summary, WorstFrame

_SIGMAS: Final = tuple(f"{limit}\N{GREEK SMALL LETTER SIGMA} %" for limit in ("1", "2", ">3"))
_LARGE: Final = 100
_LEGEND: Final = (
    "with std %: errors with a standard deviation; then the shares within 1 and 2 of it, and beyond 3",
    "NEES: mean squared error in units of it; 1 is right, more is overconfident; interval by blocks",
)
REASONS_SHOWN: Final = 10
LISTED: Final = 12
"""Runs or configurations per row; if there are more, those with the worst p95 are listed."""
Summaries = Sequence[Summary]
"""The subjects of a table: runs or pooled runs, side by side."""
Cells = Mapping[str, Sequence[str]]
"""The cells of a row by subject."""
_STATUSES: Final = ("measured", "held", "lost")
_LANE_COLUMNS: Final = "columns: lane_left_status, lane_left_offset_m, lane_left_raw_offset_m; the same for right"
_JITTER: Final = "jitter: standard deviation of the offset's second difference, smoothed and raw"
_LAG: Final = "lag: frames by which the smoothed offset lags the true one; \N{EN DASH} if unknown"
_ERRORS: Final = "median, p95 and worst are of the absolute error, bias is the median error"
_COVERAGE: Final = "frames %: those with a value; p5 instead of p95, and the lowest as worst, where high is better"
_CLASSES: Final = 6
"""Most estimated classes with a column."""
_CONFUSION: Final = (
    "in the columns: estimated class, lane_left_boundary_class and lane_right_boundary_class together; none: lost or "
    "unknown; in the rows: lane_left_true_boundary_class and lane_right_true_boundary_class"
)
_NO_TRUTH: Final = "No frame has truth for the replayed stages."
_SECONDS: Final = "s: seconds from the log's first frame"
_SEGMENTS: Final = "a segment starts at the time at which the previous one ended"


def full_tables(summaries: Summaries) -> Iterator[Table]:
    """All tables in their order, including those without rows."""
    tables = (
        coverage,
        lane_boundaries,
        boundary_classes,
        missing_outputs,
        accuracy,
        consistency_table,
        detection_counts,
        latency,
    )
    return (table(summaries) for table in tables)


def coverage(summaries: Summaries) -> Table:
    """Coverage and typical values of the outputs, without truth; a note names the columns without values."""
    states = (_states(summaries, column) for column in ("surface_source", "surface_model", "odometry_status"))
    rows = dict(chain(chain.from_iterable(states), _quantities(summaries, SEEN, _typical)))
    absent = no_values(summaries)
    notes = (f"no values: {absent}",) if absent else ()
    about = {quantity.column: quantity.label for quantity in SEEN}
    return _table("Coverage", ("frames %", "p5", "median", "p95"), rows, summaries, notes, about=about)


def lane_boundaries(summaries: Summaries) -> Table:
    """Per side: shares of measured, held and lost, the offset, and its jitter, smoothed and raw."""
    present = any(summary.categories[f"lane_{side}_status"] for summary in summaries for side in SIDES)
    rows = {side: _first(summaries, partial(_boundary, side=side)) for side in SIDES if present}
    lag = any(summary.correlations for summary in summaries)
    notes = (_LANE_COLUMNS, _JITTER, *([_LAG] if lag else []), *_remarks(summaries, _beyond_lanes)) if present else ()
    headers = (*(f"{status} %" for status in _STATUSES), "offset m", "jitter cm", "raw cm", *(["lag"] if lag else []))
    return _table("Lane boundary", headers, rows, summaries, notes, label_columns=13)


def boundary_classes(summaries: Summaries) -> Table:
    """Confusion of the classes beyond the boundaries: a row for each true class, percentages of the estimates."""
    found = {summary.name: _class_pairs(summary) for summary in summaries}
    most_common = [pair for pair, _ in sum(found.values(), Counter[tuple[str, ...]]()).most_common()]
    seen = [*dict.fromkeys(estimate for _, estimate in most_common if estimate)][:_CLASSES]
    rows = {
        truth: {name: cells for name, pairs in found.items() if (cells := _class_shares(pairs, truth, (*seen, "")))}
        for truth in dict.fromkeys(truth for truth, _ in most_common)
    }
    headers = ("boundaries", *(f"{name} %" for name in seen), "none %")
    return _table("True class beyond", headers, rows, summaries, (_CONFUSION,) if rows else (), label_columns=17)


def missing_outputs(summaries: Summaries, *, vary_only: bool = False) -> Table:
    """Reasons of absent outputs and their numbers of frames; the rarest reasons are only counted.

    With ``vary_only`` reasons with the same share of the frames in all summaries are left out.
    """
    found = ranked_reasons(merged(summary.reasons for summary in summaries))
    if vary_only:
        shares = {kind: {percent(summary.reason_share(kind)) for summary in summaries} for kind in found}
        found = {kind: reason for kind, reason in found.items() if len(shares[kind]) > 1}
    rows = {str(reason): _reason(summaries, kind) for kind, reason in islice(found.items(), REASONS_SHOWN)}
    rest = len(found) - REASONS_SHOWN
    others = {f"{rest} other reason{'s' * (rest > 1)}": dict[str, Sequence[str]]()} if rest > 0 else {}
    return _table("Missing outputs", ("frames", "frames %"), {**rows, **others}, summaries)


def accuracy(summaries: Summaries) -> Table:
    """Errors (estimate minus truth) beside coverage; a note names the quantities without truth."""
    headers = ("frames %", "bias", "median", "p95", "worst")
    rows = dict(_quantities(summaries, ERRORS, _accuracy))
    absent = [q.column for q in TRUTH if not any(q.column in summary.statistics for summary in summaries)]
    without = [f"No frame has an estimate and a truth for: {'; '.join(absent)}."] if absent else []
    notes = (_ERRORS, _COVERAGE, *(without if len(absent) < len(TRUTH) else [_NO_TRUTH]))
    about = {q.column: f"{q.label}; {better(q)}" for q in ERRORS}
    return _table("Accuracy", headers, rows, summaries, notes if rows else (_NO_TRUTH,), about=about)


def consistency_table(summaries: Summaries) -> Table:
    """Errors in units of the chain's standard deviations, where truth is known."""
    columns = [judged.estimate for judged in JUDGED if any(judged.estimate in s.consistency for s in summaries)]
    found = {name: _first(summaries, partial(_consistency, column=name)) for name in columns}
    rows = {name: cells for name, cells in found.items() if cells}
    without = [name for name in columns if name not in rows]
    notes = [*(_LEGEND if rows else ()), *([f"no standard deviation: {', '.join(without)}"] if without else [])]
    headers = ("errors", "with std %", *_SIGMAS, "NEES", f"{LEVEL:.0%} interval")
    return _table("Consistency", headers, rows, summaries, tuple(notes), label_columns=27)


def detection_counts(summaries: Summaries) -> Table:
    """Precision, recall and F1 over all frames, and their counts."""
    found = [{score.name: score for score in summary.scores} for summary in summaries]
    names = dict.fromkeys(name for scores in found for name in scores)
    rows = {
        name: {s.name: scores[name].cells(3) for s, scores in zip(summaries, found, strict=True) if name in scores}
        for name in names
    }
    notes = [f"{name}: {', '.join(COUNTED[name])}" for name in names]
    headers = ("precision", "recall", "F1", "TP", "FP", "FN")
    return _table("Detection counts", headers, rows, summaries, tuple(notes))


def latency(summaries: Summaries) -> Table:
    """Time per stage, and the speed relative to the log's time."""
    rows = dict(_quantities(summaries, STAGE_TIMES, _times))
    headers = ("median ms", "p95 ms", "p99 ms", "share %")
    return _table("Latency", headers, rows, summaries, tuple(_remarks(summaries, _speed)))


def worst_frames(summaries: Summaries) -> Table:
    """The worst frames of each summary by every error, or by suspect quantities if there is no truth.

    With several runs each line names its run.
    """
    several = sum(summary.runs for summary in summaries) > 1
    rows = (line for quantity in ranked_by(summaries) for line in _worst(summaries, quantity, several))
    headers = ("value", "frame", "s", "stamp ns")
    one_after_another = any(summary.segments > summary.runs for summary in summaries)
    notes = (f"{_SECONDS}; {_SEGMENTS}" if one_after_another else _SECONDS,)
    return Table("Worst frames", headers, tuple(rows), notes, label_columns=20)


def ranked_by(summaries: Summaries) -> list[Quantity]:
    """The quantities that have worst frames."""
    return ranked({column for summary in summaries for column, frames in summary.worst.items() if frames})


def no_values(summaries: Summaries) -> str:
    """The columns that are null in every frame, except truth and times."""
    apart = {quantity.column for quantity in (*STAGE_TIMES, *ERRORS)}
    names = [*(q.column for q in STORED if q.column not in apart), *CATEGORIES]
    present = {name for name in names for s in summaries if name in s.statistics or s.categories.get(name)}
    return ", ".join(_collapsed([name for name in names if name not in present], present))


def better(quantity: Quantity) -> str:
    """A text for the side of the good values."""
    return {"high": "higher is better", "near 0": "0 is best"}.get(quantity.better, "lower is better")


def _table(
    title: str,
    headers: tuple[str, ...],
    rows: Mapping[str, Cells],
    summaries: Summaries,
    notes: Sequence[str] = (),
    *,
    about: Mapping[str, str] | None = None,
    label_columns: int = 26,
) -> Table:
    lines = rows_of_subjects(rows, len(summaries) > 1)
    return Table(title, headers, lines, notes, about or {}, label_columns=label_columns)


def _first(summaries: Summaries, cells: Callable[[Summary], Sequence[str]]) -> Cells:
    """The cells of the first summaries that have some."""
    found = ((summary.name, cells(summary)) for summary in summaries)
    return dict(islice(((name, texts) for name, texts in found if texts), LISTED))


def _states(summaries: Summaries, column: str) -> Iterator[tuple[str, Cells]]:
    """A row for each value of a text column, with its share of the frames."""
    total = sum((summary.categories[column] for summary in summaries), Counter[str]())
    for value, _ in total.most_common():
        yield f"{column}: {value}", {s.name: (percent(s.share(column, value)),) for s in summaries[:LISTED]}


def _quantities(
    summaries: Summaries,
    quantities: Iterable[Quantity],
    cells: Callable[[Summary, Quantity, Statistics], tuple[str, ...]],
) -> Iterator[tuple[str, Cells]]:
    """A row for each quantity with values in any summary."""
    for quantity in quantities:
        having = [summaries[place] for place in listed(summaries, quantity)]
        if having:
            yield quantity.column, {s.name: cells(s, quantity, s.statistics[quantity.column]) for s in having}


def listed(summaries: Summaries, quantity: Quantity) -> tuple[int, ...]:
    """Indices of the summaries with values, in order; if there are too many, the worst ones."""
    having = [place for place, summary in enumerate(summaries) if quantity.column in summary.statistics]
    if len(having) <= LISTED:
        return tuple(having)
    tails = {place: _tail(summaries[place].statistics[quantity.column], quantity) for place in having}
    return tuple(sorted(having, key=lambda place: -tails[place])[:LISTED])


def _tail(found: Statistics, quantity: Quantity) -> float:
    return -found.p5 if quantity.better == "high" else found.abs_p95


def _typical(summary: Summary, quantity: Quantity, found: Statistics) -> tuple[str, ...]:
    values = (rounded(value, quantity) for value in (found.p5, found.median, found.p95))
    return (percent(summary.coverage(quantity.column)), *values)


def _accuracy(summary: Summary, quantity: Quantity, found: Statistics) -> tuple[str, ...]:
    """Coverage, bias (signed median), and median, p95 (or p5) and worst of the absolute error."""
    share = percent(summary.coverage(quantity.column))
    bias = rounded(found.median, quantity) if quantity.better == "near 0" else ""
    if quantity.better == "high":
        tail, most = f"p5 {rounded(found.p5, quantity)}", found.least
    else:
        tail, most = rounded(found.abs_p95, quantity), found.abs_most
    return (share, bias, rounded(found.abs_median, quantity), tail, rounded(most, quantity))


def _times(summary: Summary, quantity: Quantity, found: Statistics) -> tuple[str, ...]:
    """Median, p95 and p99 in ms, and the percentage of the total time."""
    total = summary.statistics[TOTAL.column]
    share = percent(found.total / total.total) if total.total > 0 else ""
    return (*(rounded(value, quantity) for value in (found.median, found.p95, found.p99)), share)


def _consistency(summary: Summary, column: str) -> tuple[str, ...]:
    """Number of errors, shares with a deviation, within 1 and 2 and beyond 3 of it, NEES and its interval."""
    found = summary.consistency.get(column)
    if found is None or not found.values:
        return ()
    shares = (found.values / found.errors, found.within(1), found.within(2), 1 - found.within(3))
    nees, *ends = (f"{v:.2f}" if v < _LARGE else f"{v:.0f}" for v in (found.nees, *(found.nees_interval or ())))
    return (str(found.errors), *map(percent, shares), nees, "-".join(ends))


def _boundary(summary: Summary, side: str) -> tuple[str, ...]:
    """Percentages by status, offset in m, jitter in cm smoothed and raw, lag in frames; empty if unknown."""
    offset = summary.statistics.get(f"lane_{side}_offset_m")
    jitters = [summary.statistics.get(f"lane_{side}_{kind}second_difference_m") for kind in ("", "raw_")]
    lag = summary.lag_frames(side) if summary.correlations else None
    return (
        *(percent(summary.share(f"lane_{side}_status", status)) for status in _STATUSES),
        f"{offset.median:z.2f}" if offset else "",
        *(f"{100 * jitter.std:.2f}" if jitter else "" for jitter in jitters),
        *(["\N{EN DASH}" if lag is None else str(lag)] if summary.correlations else []),
    )


def _beyond_lanes(summary: Summary) -> str:
    """Classes beyond the boundaries, as shares of the frames in which they are known."""
    sides = [(side, summary.categories[f"lane_{side}_boundary_class"]) for side in SIDES]
    return "; ".join(
        f"beyond the {side}: "
        + ", ".join(f"{name} {number / classes.total():.0%}" for name, number in classes.most_common(3))
        for side, classes in sides
        if classes
    )


def _class_pairs(summary: Summary) -> Counter[tuple[str, ...]]:
    """Numbers of true and estimated classes beyond both boundaries; an unknown estimate is empty."""
    counts = sum((summary.categories[name] for name in CONFUSED), Counter[str]())
    return Counter({tuple(text.split(BETWEEN)): count for text, count in counts.items()})


def _class_shares(pairs: Counter[tuple[str, ...]], truth: str, estimates: Iterable[str]) -> tuple[str, ...]:
    """Number of boundaries with a true class, and the percentage of each estimate."""
    boundaries = sum(count for (true, _), count in pairs.items() if true == truth)
    return (str(boundaries), *(percent(pairs[truth, name] / boundaries) for name in estimates)) if boundaries else ()


def _reason(summaries: Summaries, kind: ReasonKind) -> Cells:
    """Number and percentage of the frames with a reason, of the summaries in which it is most frequent."""
    having = [summary for summary in summaries if kind in summary.reasons]
    least = sorted(summary.reason_share(kind) for summary in having)[-LISTED:][0]
    shown = [summary for summary in having if summary.reason_share(kind) >= least][:LISTED]
    return {s.name: (str(s.reasons[kind].frames), percent(s.reason_share(kind))) for s in shown}


def _speed(summary: Summary) -> str:
    """Frames per second of one core's time, and the ratio to real time."""
    total = summary.statistics.get(TOTAL.column)
    if total is None or total.total <= 0:
        return ""
    rate_hz = 1000 * total.values / total.total
    against = f", {rate_hz / summary.rate_hz:.1f} times real time" if summary.rate_hz else ""
    return f"{rate_hz:.1f} frames/s per core{against}"


def _remarks(summaries: Summaries, remark: Callable[[Summary], str]) -> Iterator[str]:
    """A remark on each of the first summaries, with its name if there are several."""
    for summary in summaries[:LISTED]:
        text = remark(summary)
        if text:
            yield f"{summary.name}: {text}" if len(summaries) > 1 else text


def _worst(summaries: Summaries, quantity: Quantity, several: bool) -> Iterator[Row]:
    having = [summaries[place].worst.get(quantity.column, ()) for place in listed(summaries, quantity)]
    frames = list(chain.from_iterable(having))
    if several:
        yield (quantity.column,)
        yield from ((f"  {frame.run}", *_worst_cells(frame, quantity)) for frame in frames)
    else:
        labels = (quantity.column, *("" for _ in frames))
        yield from ((label, *_worst_cells(frame, quantity)) for label, frame in zip(labels, frames, strict=False))


def _worst_cells(frame: WorstFrame, quantity: Quantity) -> list[str]:
    return [rounded(frame.value, quantity), str(frame.frame), f"{frame.since_start_s:.3f}", str(frame.stamp_ns)]


def _collapsed(absent: Sequence[str], present: Iterable[str]) -> list[str]:
    """Names, those with the same first word as ``word*`` if no column with values starts with it."""
    used = {name.split("_")[0] for name in present}
    words = [name.split("_")[0] for name in absent]
    sizes = Counter(words)
    pairs = zip(absent, words, strict=True)
    return list(dict.fromkeys(f"{word}*" if sizes[word] > 1 and word not in used else name for name, word in pairs))
