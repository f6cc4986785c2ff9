"""Two metrics tables side by side: which frames both have, and how their columns agree."""

from dataclasses import dataclass
from typing import Any, Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.record import LOG_ID_KEY

from ..collecting import collect
from ..scan import rows_of
from .agreement import ABSENT, Agreement, Difference, Value
from .pairing import KEY, STAMP, LoggedRun, RunPair, numbered, segments_of
from .rules import Rules

NOT_COMPARED = (STAMP, "config", *TIME_COLUMNS)
"""What pairs frames, names what made the tables, or is no two runs' the same."""
_CANDIDATE = " of the candidate"
_PLAIN: Final = (pl.String, pl.Boolean, pl.Null)


@dataclass(frozen=True)
class Overlap:
    """How many frames two tables share, and how many only one of them has."""

    common: int
    only_reference: int
    only_candidate: int


def overlap(pair: RunPair) -> Overlap:
    """The frames of both tables, paired by their stamps.

    Raises:
        TableError: they share none, or a table's data cannot be read.
    """
    ours, theirs = (_whole(item, pair.by_segment).select(KEY) for item in (pair.reference, pair.candidate))
    common = ours.join(theirs, on=KEY).height
    if not common:
        raise TableError(
            f"{pair.candidate.run.path}: shares no stamp with {pair.reference.run.path}: "
            f"{_span(theirs)}, expected some of {_span(ours)}"
        )
    return Overlap(common, ours.height - common, theirs.height - common)


def table_agreements(pair: RunPair, rules: Rules) -> dict[str, Agreement]:
    """How each column agrees over the frames both tables have.

    The times, which no two runs share, are left out, and ``log_id`` where two algorithms made it.
    """
    joined = _joined(pair)
    left_out = NOT_COMPARED if pair.by_one_digest else (*NOT_COMPARED, LOG_ID_KEY)
    columns = sorted(pair.reference.run.columns | pair.candidate.run.columns, key=_order(pair))
    compared = [name for name in columns if name not in left_out and not rules.ignores(name)]
    return {name: _column(joined, name, pair.name, rules.tolerance(name)) for name in compared}


def _joined(pair: RunPair) -> pl.DataFrame:
    """Frames of both, in the order of time: columns of the candidate behind a suffix, those of neither side's null."""
    ours, theirs = (_whole(item, pair.by_segment) for item in (pair.reference, pair.candidate))
    theirs = theirs.rename({name: name + _CANDIDATE for name in theirs.columns if name not in KEY})
    return ours.join(theirs, on=KEY).sort(KEY)


def _whole(item: LoggedRun, by_segment: bool) -> pl.DataFrame:
    return collect(numbered(rows_of(item.run), segments_of(item, by_segment)), item.run.source_name)


def _order(pair: RunPair) -> Any:
    """Columns in the order of the reference's table, those it lacks behind."""
    listed = pl.scan_parquet(pair.reference.run.path, glob=False).collect_schema().names()
    places = {name: index for index, name in enumerate(listed)}
    return lambda name: (places.get(name, len(places)), name)


def _column(joined: pl.DataFrame, name: str, run: str, tolerance: float) -> Agreement:
    ours, theirs = _comparable(_side(joined, name), _side(joined, name + _CANDIDATE))
    apart = _distances(ours, theirs)
    beyond = apart > tolerance
    first = beyond.arg_max() if beyond.any() else None
    finite = apart.filter(apart.is_finite())
    return Agreement(
        within=int(((apart > 0) & ~beyond).sum()),
        differing=int(beyond.sum()),
        largest=float(finite.max() or 0.0),  # type: ignore[arg-type]
        first=None if first is None else _difference(joined, name, run, first, (ours[first], theirs[first])),
    )


def _side(joined: pl.DataFrame, name: str) -> pl.Series:
    if name not in joined.columns:
        return pl.Series(name, [None] * joined.height, pl.Float64)
    column = joined[name]
    if column.dtype in (pl.List(pl.String), pl.List(pl.Null)):
        return column.cast(pl.List(pl.String)).list.join("; ")
    return column if column.dtype.is_numeric() or column.dtype in _PLAIN else _as_text(column)


def _as_text(column: pl.Series) -> pl.Series:
    """A column of a type that no replay writes, such as a duration or a struct: not all of them can be cast."""
    return pl.Series(column.name, [None if value is None else str(value) for value in column.to_list()], pl.String)


def _comparable(ours: pl.Series, theirs: pl.Series) -> tuple[pl.Series, pl.Series]:
    """Two columns of one type: numbers where both are, else text; a column of nulls takes the other's."""
    numeric = all(side.dtype.is_numeric() or side.null_count() == side.len() for side in (ours, theirs))
    kind = pl.Float64 if numeric else pl.String
    return ours.cast(kind), theirs.cast(kind)


def _distances(ours: pl.Series, theirs: pl.Series) -> pl.Series:
    """``agreement.distance`` of every row."""
    equal = ours.eq_missing(theirs)
    if ours.dtype == pl.String:
        return pl.select(pl.when(equal).then(0.0).otherwise(ABSENT)).to_series()
    apart = (ours - theirs).abs().fill_nan(ABSENT).fill_null(ABSENT)
    return pl.select(pl.when(equal).then(0.0).otherwise(apart)).to_series()


def _difference(joined: pl.DataFrame, name: str, run: str, row: int, values: tuple[Value, Value]) -> Difference:
    return Difference(run, joined["frame"][row], joined[STAMP][row], name, *values)


def _span(stamps: pl.DataFrame) -> str:
    return f"{stamps[STAMP].item(0)} to {stamps[STAMP].item(-1)}"


def same_but_for_times(pair: RunPair) -> bool:
    """Whether two tables hold the same frames with the same results, however long they took."""
    ours, theirs = (
        _whole(item, by_segment=False).drop(TIME_COLUMNS, strict=False) for item in (pair.reference, pair.candidate)
    )
    return ours.equals(theirs)
