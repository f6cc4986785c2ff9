"""The page's tables: what the runs are, and their summaries, a column or a group of figures per run."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

from roadperc_stream.core.reasons import merged, ranked

from ..grid import percent, rounded
from ..quantities import SEEN, SIDES, STAGES, TOTAL, TRUTH, Quantity
from ..scores import Score
from ..sections import REASONS_SHOWN, boundary
from ..statistics import Statistics
from ..summary import Summary
from .histograms import better
from .sources import Sources

UNKNOWN: Final = "-"
_HOW_TO_READ: Final = (
    "Median, p95 and worst are of the absolute error, bias is the median error. Coverage is the share of all frames "
    "that have a value. Where high is good, p95 is the 5 % quantile (p5) and worst the least."
)
_STATUSES: Final = ("measured", "held", "lost")
_OF_BOUNDARIES: Final = (
    "The offset is the median; jitter is the standard deviation of its second difference, smoothed and raw; lag is "
    "by how many frames the smoothed offset lies behind the true one, where that can be told."
)


@dataclass(frozen=True)
class Row:
    """A line of a table: its label, which way is better, and per run the cells under the table's headers.

    A run without values has no cells.
    """

    label: str
    better: str
    runs: tuple[tuple[str, ...], ...]

    def beside(self, headers: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
        """The row turned: of each header that any run has a cell under, the cells of all runs side by side."""
        padded = [cells or ("",) * len(headers) for cells in self.runs]
        lines = zip(headers, zip(*padded, strict=True), strict=True)
        return [(header, cells) for header, cells in lines if any(cells)]


@dataclass(frozen=True)
class Table:
    """A table of the page. ``note`` says how to read it."""

    title: str
    headers: tuple[str, ...]
    rows: tuple[Row, ...]
    note: str = ""


def identity(summaries: Sequence[Summary], sources: Sequence[Sources]) -> Table:
    """What each run is: log, configuration, version, names and extent."""
    facts = [_facts(summary, files) for summary, files in zip(summaries, sources, strict=True)]
    rows = tuple(Row(label, "", tuple((fact[label],) for fact in facts)) for label in facts[0])
    return Table("What was replayed", ("",), rows)


def _facts(summary: Summary, files: Sources) -> dict[str, str]:
    rate = f", {summary.rate_hz:.1f} a second" if summary.rate_hz else ""
    missing = ", ".join(f"{role} {percent(n / summary.frames)} %" for role, n in summary.missing.most_common())
    return {
        "log": ", ".join(summary.log_ids),
        "configuration": summary.configs[0][:8] or "unknown",
        "version": summary.versions[0] or "unknown",
        "input": files.source.name if files.source else "not named",
        "output": files.log.name if files.log else "not named",
        "frames": f"{summary.frames} over {summary.span_s:.2f} s{rate}",
        "longest gap": f"{summary.longest_gap_s:.2f} s",
        "messages missing": missing or "none in any frame",
    }


def summary_tables(summaries: Sequence[Summary]) -> Iterator[Table]:
    """Right, lanes, seen, why not, fast: the first always, as it says what has no truth, the others where not empty."""
    yield _right(summaries)
    seen = _table("Does it see?", ("coverage %", "p5", "median", "p95"), SEEN, summaries, _values)
    fast = _table("How fast?", ("median", "p95", "p99", "share %"), STAGES, summaries, _times)
    boundaries = (*(f"{status} %" for status in _STATUSES), "offset, m", "jitter, cm", "raw, cm", "lag")
    tables = (
        Table("Precision and recall", ("precision", "recall", "F1"), tuple(_scores(summaries)), "Higher is better."),
        Table("Lane boundaries", boundaries, tuple(_lanes(summaries)), _OF_BOUNDARIES),
        seen,
        Table("Why not?", ("frames %",), tuple(_reasons(summaries)), "What was missing or could not be used."),
        Table(fast.title, fast.headers, fast.rows, "Milliseconds a frame; lower is better."),
    )
    yield from (table for table in tables if table.rows)


def _right(summaries: Sequence[Summary]) -> Table:
    found = _table("Is it right?", ("coverage %", "bias", "median", "p95", "worst"), TRUTH, summaries, _accuracy)
    absent = [q.label for q in TRUTH if not any(q.column in summary.statistics for summary in summaries)]
    lacking = f"No frame has a truth for: {'; '.join(absent)}." if absent else ""
    note = f"{_HOW_TO_READ} {lacking}" if found.rows else "No frame has a truth for what was replayed."
    return Table(found.title, found.headers, tuple(_judged(row) for row in found.rows), note.strip())


def _table(
    title: str,
    headers: tuple[str, ...],
    quantities: Sequence[Quantity],
    summaries: Sequence[Summary],
    cells: Callable[[Summary, Quantity, Statistics], tuple[str, ...]],
) -> Table:
    rows = [_row(quantity, summaries, cells) for quantity in quantities]
    return Table(title, headers, tuple(row for row in rows if any(row.runs)))


def _row(
    quantity: Quantity,
    summaries: Sequence[Summary],
    cells: Callable[[Summary, Quantity, Statistics], tuple[str, ...]],
) -> Row:
    found = [(summary, summary.statistics.get(quantity.column)) for summary in summaries]
    return Row(quantity.label, "", tuple(cells(summary, quantity, s) if s else () for summary, s in found))


def _judged(row: Row) -> Row:
    """The row with which way is better."""
    return Row(row.label, better(next(q for q in TRUTH if q.label == row.label)), row.runs)


def _accuracy(summary: Summary, quantity: Quantity, found: Statistics) -> tuple[str, ...]:
    low = quantity.worse == "low"
    tail, most = (found.p5, found.least) if low else (found.abs_p95, found.abs_most)
    bias = rounded(found.median, quantity) if quantity.signed else ""
    cells = (rounded(value, quantity) for value in (found.abs_median, tail, most))
    return (percent(summary.coverage(quantity.column)), bias, *cells)


def _values(summary: Summary, quantity: Quantity, found: Statistics) -> tuple[str, ...]:
    values = (rounded(value, quantity) for value in (found.p5, found.median, found.p95))
    return (percent(summary.coverage(quantity.column)), *values)


def _times(summary: Summary, quantity: Quantity, found: Statistics) -> tuple[str, ...]:
    total = summary.statistics.get(TOTAL.column)
    share = percent(found.total / total.total) if total and total.total > 0 else UNKNOWN
    return (*(rounded(value, quantity) for value in (found.median, found.p95, found.p99)), share)


def _reasons(summaries: Sequence[Summary]) -> Iterator[Row]:
    """The most frequent reasons over all runs, and in which share of each run's frames they were given."""
    found = ranked(merged(summary.reasons for summary in summaries))
    for kind, reason in islice(found.items(), REASONS_SHOWN):
        yield Row(str(reason), "", tuple((percent(summary.reason_share(kind)),) for summary in summaries))


def _lanes(summaries: Sequence[Summary]) -> Iterator[Row]:
    for side in SIDES:
        name = f"lane_{side}_status"
        if any(summary.categories[name] for summary in summaries):
            yield Row(side, "", tuple(_lane(summary, side) for summary in summaries))


def _lane(summary: Summary, side: str) -> tuple[str, ...]:
    return tuple(cell or UNKNOWN for cell in boundary(summary, side))


def _scores(summaries: Sequence[Summary]) -> Iterator[Row]:
    by_run = [{score.name: score for score in summary.scores} for summary in summaries]
    for name in dict.fromkeys(name for found in by_run for name in found):
        yield Row(name, "", tuple(_shares(found.get(name)) for found in by_run))


def _shares(score: Score | None) -> tuple[str, ...]:
    if score is None:
        return ()
    return tuple(UNKNOWN if share is None else f"{share:.3f}" for share in (score.precision, score.recall, score.f1))
