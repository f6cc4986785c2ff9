"""What is counted over the frames of a table, and what the counts of several come to."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import polars as pl

from roadperc_stream.core.reasons import ReasonCounts, grouped, merged

from .quantities import CATEGORIES
from .scores import COUNTS


@dataclass(frozen=True)
class Tallies:
    """Counts over frames.

    ``incomplete`` counts frames where any role is without a message; ``categories`` the values of each text column;
    ``missing`` the frames per role without a message; ``reasons`` say why something is absent; ``totals`` are the sums
    of the counting columns that have values.
    """

    incomplete: int
    categories: Mapping[str, Counter[str]]
    missing: Counter[str]
    reasons: ReasonCounts
    totals: Mapping[str, int]


def tallies() -> list[pl.Expr]:
    """What ``tallied`` takes: counts of frames and texts, and sums, null where no frame has a value."""
    return [
        (pl.col("missing").list.len() > 0).sum().alias("incomplete"),
        *(_texts(name) for name in CATEGORIES),
        *(_texts(name, of_lists=True) for name in ("missing", "reasons")),
        *(pl.when(pl.col(name).count() > 0).then(pl.col(name).sum()).cast(pl.Int64) for name in COUNTS),
    ]


def tallied(found: Mapping[str, Any]) -> Tallies:
    """The counts in a row of ``tallies``."""
    return Tallies(
        incomplete=found["incomplete"],
        categories={name: _counter(found[name]) for name in CATEGORIES},
        missing=_counter(found["missing"]),
        reasons=grouped(_counter(found["reasons"])),
        totals={name: found[name] for name in COUNTS if found[name] is not None},
    )


def tallied_together(parts: Iterable[Tallies]) -> Tallies:
    """The counts over all parts."""
    listed = list(parts)
    return Tallies(
        incomplete=sum(part.incomplete for part in listed),
        categories={name: _added(part.categories[name] for part in listed) for name in CATEGORIES},
        missing=_added(part.missing for part in listed),
        reasons=merged(part.reasons for part in listed),
        totals=_added(part.totals for part in listed),
    )


def _texts(name: str, *, of_lists: bool = False) -> pl.Expr:
    """How often each text occurs: a list of structs of ``text`` and ``count``, by text."""
    column = pl.col(name)
    texts = (column.explode() if of_lists else column).drop_nulls()
    counted = texts.value_counts(sort=True)
    return counted.struct.rename_fields(["text", "count"]).implode().alias(name)


def _counter(rows: Iterable[Mapping[str, Any]]) -> Counter[str]:
    return Counter({row["text"]: row["count"] for row in rows})


def _added(counters: Iterable[Mapping[str, int]]) -> Counter[str]:
    total: Counter[str] = Counter()
    for counter in counters:
        total.update(counter)
    return total
