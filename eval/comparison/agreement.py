"""How far the fields of two runs agree, frame by frame: first the columns of their tables."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Final, Literal

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.record import LOG_ID_KEY

from ..options import Rules
from ..runs import Run, collect
from ..scan import rows_of
from .pairing import KEY, STAMP, RunPair, numbered

Value = float | int | str | bool | None
State = Literal["identical", "within tolerance", "differs"]
ABSENT: Final = math.inf
"""Distance of a value from none, or from a value of another kind or text."""
NOT_COMPARED = (STAMP, "config", *TIME_COLUMNS)
"""What pairs frames, names what made the tables, or is no two runs' the same."""
_CANDIDATE = " of the candidate"
_PLAIN: Final = (pl.String, pl.Boolean, pl.Null)


@dataclass(frozen=True)
class Difference:
    """Both values of a field in one frame; ``place`` is the field with the indices of its lists."""

    run: str
    frame: int
    stamp_ns: int
    place: str
    reference: Value
    candidate: Value

    @property
    def at(self) -> tuple[str, int, int]:
        """The frame it is in, in the order of time."""
        return self.run, self.stamp_ns, self.frame


@dataclass(frozen=True)
class Agreement:
    """How one field agrees over all frames compared.

    ``within`` and ``differing`` count the frames with a difference within and beyond the tolerance; ``largest`` is the
    largest distance between two numbers in its unit, ``first`` the first difference beyond the tolerance.
    """

    within: int = 0
    differing: int = 0
    largest: float = 0.0
    first: Difference | None = None

    @property
    def state(self) -> State:
        """The verdict on the field."""
        if self.differing:
            return "differs"
        return "within tolerance" if self.within else "identical"

    def and_then(self, later: "Agreement") -> "Agreement":
        """This and what was found in later frames, together."""
        return Agreement(
            self.within + later.within,
            self.differing + later.differing,
            max(self.largest, later.largest),
            self.first or later.first,
        )


Agreements = Mapping[str, Agreement]
"""By the name of the field, without indices."""


def distance(reference: Value, candidate: Value) -> float:
    """Absolute difference of two numbers, 0 of equal values, else ``ABSENT``; NaN equals NaN."""
    if reference == candidate:
        return 0.0
    if not (isinstance(reference, int | float) and isinstance(candidate, int | float)):
        return ABSENT
    if math.isnan(reference) and math.isnan(candidate):
        return 0.0
    apart = abs(reference - candidate)
    return ABSENT if math.isnan(apart) else apart


def together(parts: Iterable[Agreements]) -> dict[str, Agreement]:
    """The agreements of several runs, one after another."""
    listed = list(parts)
    names = dict.fromkeys(name for part in listed for name in part)
    return {
        name: reduce(Agreement.and_then, (part[name] for part in listed if name in part), Agreement()) for name in names
    }


@dataclass(frozen=True)
class Overlap:
    """How many frames two tables share, and how many only one of them has."""

    common: int
    only_reference: int
    only_candidate: int


def compare_tables(pair: RunPair, rules: Rules) -> tuple[Overlap, dict[str, Agreement]]:
    """The frames of both tables, paired by their stamps, and how each column agrees over those that both have.

    The times, which no two runs share, are left out, and ``log_id`` where two algorithms made it.

    Raises:
        TableError: they share no frame, or a table's data cannot be read.
    """
    ours, theirs = (_whole(run, pair.by_segment) for run in (pair.reference, pair.candidate))
    listed = [name for name in ours.columns if name not in KEY]
    renamed = theirs.rename({name: name + _CANDIDATE for name in theirs.columns if name not in KEY})
    joined = ours.join(renamed, on=KEY).sort(KEY)
    common = joined.height
    if not common:
        found, expected = (f"{side[STAMP].item(0)} to {side[STAMP].item(-1)}" for side in (theirs, ours))
        raise TableError(
            f"{pair.candidate.path}: shares no stamp with {pair.reference.path}: {found}, expected some of {expected}"
        )
    left_out = NOT_COMPARED if pair.by_one_digest else (*NOT_COMPARED, LOG_ID_KEY)
    columns = [*listed, *sorted(pair.columns.difference(listed))]
    compared = [name for name in columns if name not in left_out and not rules.ignores(name)]
    agreements = {name: _column(joined, name, pair.name, rules.tolerance(name)) for name in compared}
    return Overlap(common, ours.height - common, theirs.height - common), agreements


def _whole(run: Run, by_segment: bool) -> pl.DataFrame:
    return collect(numbered(rows_of(run), run, by_segment), run.source_name)


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
        first=None
        if first is None
        else Difference(run, joined["frame"][first], joined[STAMP][first], name, ours[first], theirs[first]),
    )


def _side(joined: pl.DataFrame, name: str) -> pl.Series:
    if name not in joined.columns:
        return pl.Series(name, [None] * joined.height, pl.Float64)
    column = joined[name]
    if column.dtype in (pl.List(pl.String), pl.List(pl.Null)):
        return column.cast(pl.List(pl.String)).list.join("; ")
    if column.dtype.is_numeric() or column.dtype in _PLAIN:
        return column
    # of a type that no replay writes, such as a duration or a struct: not all of them can be cast
    return pl.Series(name, [None if value is None else str(value) for value in column.to_list()], pl.String)


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


def same_but_for_times(pair: RunPair) -> bool:
    """Whether two tables hold the same frames with the same results, however long they took."""
    ours, theirs = (
        _whole(run, by_segment=False).drop(TIME_COLUMNS, strict=False) for run in (pair.reference, pair.candidate)
    )
    return ours.equals(theirs)
