"""The rows of the report's table of consistency, and what there is to say below it."""

from collections.abc import Sequence
from typing import Final

from roadperc_stream.output.text_table import TextRow

from .comparison.bootstrap import LEVEL
from .consistency import JUDGED, Consistency
from .grid import percent
from .summary import Summary

CONSISTENCY_HEADERS: Final = (
    "errors",
    "with std %",
    "1\N{GREEK SMALL LETTER SIGMA} %",
    "2\N{GREEK SMALL LETTER SIGMA} %",
    ">3\N{GREEK SMALL LETTER SIGMA} %",
    "NEES",
    f"{LEVEL:.0%} interval",
)
_LARGE: Final = 100
_LEGEND: Final = (
    "with std %: errors whose standard deviation is given; of these within 1 and 2 of it, and beyond 3",
    "NEES: mean of the squared errors in units of it: 1 is right, more claims too much; interval by blocks",
)


def consistency_rows(summaries: Sequence[Summary]) -> list[TextRow]:
    """A row for each quantity that any summary has a standard deviation and a truth of."""
    found = {judged.name: [summary.consistency.get(judged.name) for summary in summaries] for judged in JUDGED}
    return [
        TextRow(name, tuple(_cells(item) if item and item.values else () for item in items))
        for name, items in found.items()
        if any(item and item.values for item in items)
    ]


def consistency_notes(summaries: Sequence[Summary]) -> tuple[str, ...]:
    """How to read the table, and the quantities whose truth is known but that no summary has a deviation of."""
    known = {name for summary in summaries for name in summary.consistency}
    believed = {name for summary in summaries for name, item in summary.consistency.items() if item.values}
    without = [judged.name for judged in JUDGED if judged.name in known and judged.name not in believed]
    absent = (f"no standard deviation: {', '.join(without)}",) if without else ()
    return (*(_LEGEND if believed else ()), *absent)


def _cells(found: Consistency) -> tuple[str, ...]:
    interval = found.nees_interval
    return (
        str(found.errors),
        percent(found.values / found.errors),
        percent(found.within(1)),
        percent(found.within(2)),
        percent(1 - found.within(3)),
        _short(found.nees),
        "" if interval is None else "-".join(map(_short, interval)),
    )


def _short(nees: float) -> str:
    return f"{nees:.2f}" if nees < _LARGE else f"{nees:.0f}"
