"""Agreement of the fields of two runs, frame by frame: of the columns of their tables, and of any two values."""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.columns.places import TRUE_OBJECTS

from ..options import Rules
from ..runs import Run, collect, written_columns
from ..scan import rows_of
from .pairing import KEY, NEW, STAMP, RunPair, numbered

Value = float | int | str | bool | None
State = Literal["identical", "within tolerance", "differs"]
INCOMPARABLE: Final = math.inf
"""Distance between a value and None, two different texts, or values of two kinds."""
NOT_COMPARED = (STAMP, "config", *TIME_COLUMNS, TRUE_OBJECTS)
"""Columns that pair the frames, name the configuration, differ in every replay, or hold lists of truth."""
_REASON: Final = pl.concat_str(
    pl.element().struct.field("source", "code"),
    pl.element().struct.field("values").list.join(" "),
    pl.element().struct.field("cause"),
    separator=" ",
    ignore_nulls=True,
).str.strip_chars_end()


@dataclass(frozen=True)
class Difference:
    """Both values of a field in one frame; ``place`` is the field's name with its list indices."""

    run: str
    frame: int
    stamp_ns: int
    place: str
    base: Value
    new: Value

    @property
    def at(self) -> tuple[str, int, int]:
        """Key of the frame; keys sort in the order of time."""
        return self.run, self.stamp_ns, self.frame


@dataclass(frozen=True)
class Agreement:
    """Agreement of one field over all compared frames.

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

    def __add__(self, later: "Agreement") -> "Agreement":
        """The agreement over these frames and ``later`` ones."""
        return Agreement(
            self.within + later.within,
            self.differing + later.differing,
            max(self.largest, later.largest),
            self.first or later.first,
        )


Agreements = Mapping[str, Agreement]
"""Agreement by field name without indices."""


def distance(base: Value, new: Value) -> float:
    """Absolute difference of two numbers, 0 for equal values, else ``INCOMPARABLE``; NaN equals NaN."""
    if base == new:
        return 0.0
    if not (isinstance(base, int | float) and isinstance(new, int | float)):
        return INCOMPARABLE
    if math.isnan(base) and math.isnan(new):
        return 0.0
    apart = abs(base - new)
    return INCOMPARABLE if math.isnan(apart) else apart


def added(parts: Iterable[Agreements]) -> dict[str, Agreement]:
    """Sums over several runs or frames, in their order."""
    total: dict[str, Agreement] = defaultdict(Agreement)
    for part in parts:
        for name, agreement in part.items():
            total[name] += agreement
    return dict(total)


class Overlap(NamedTuple):
    """Number of frames that both tables have, and that only one has."""

    common: int
    only_base: int
    only_new: int


def compare_tables(pair: RunPair, rules: Rules) -> tuple[Overlap, dict[str, Agreement]]:
    """Pair the frames of two tables by stamp and compare each column over the common frames.

    Times are not compared.

    Raises:
        TableError: the tables share no frame, or a table's data cannot be read.
    """
    ours, theirs = (_rows(run, pair.by_segment) for run in (pair.base, pair.new))
    columns = [name for name in ours.columns if name not in KEY]
    columns += sorted(pair.columns.difference(columns))
    renamed = theirs.rename({name: name + NEW for name in theirs.columns if name not in KEY})
    joined = ours.join(renamed, on=KEY).sort(KEY)
    common = joined.height
    if not common:
        found, expected = (f"{side[STAMP].item(0)} to {side[STAMP].item(-1)}" for side in (theirs, ours))
        raise TableError(
            f"{pair.new.path}: shares no stamp with {pair.base.path}: {found}, expected some of {expected}"
        )
    compared = [name for name in columns if name not in NOT_COMPARED and not rules.ignores(name)]
    agreements = {name: column_agreement(joined, name, pair.name, rules.tolerance(name)) for name in compared}
    return Overlap(common, ours.height - common, theirs.height - common), agreements


def _rows(run: Run, by_segment: bool) -> pl.DataFrame:
    return collect(numbered(rows_of(run), by_segment), run.source_name)


def column_agreement(joined: pl.DataFrame, name: str, run: str, tolerance: float = 0.0) -> Agreement:
    """Agreement of a column of two tables, joined row by row; the new table's has the suffix ``NEW``."""
    ours, theirs = _of_one_type(_side(joined, name), _side(joined, name + NEW))
    apart = _distances(ours, theirs)
    beyond = apart > tolerance
    finite = apart.filter(apart.is_finite())
    first = None
    if (at := beyond.arg_max()) is not None and beyond[at]:
        first = Difference(run, joined["frame"][at], joined[STAMP][at], name, ours[at], theirs[at])
    return Agreement(
        within=int(((apart > 0) & ~beyond).sum()),
        differing=int(beyond.sum()),
        largest=float(finite.max() or 0.0),  # type: ignore[arg-type]
        first=first,
    )


def _side(joined: pl.DataFrame, name: str) -> pl.Series:
    if name not in joined.columns:
        return pl.Series(name, [None] * joined.height, pl.Float64)
    column = joined[name]
    if column.dtype == written_columns()["reasons"]:
        column = column.list.eval(_REASON)
    if isinstance(column.dtype, pl.List):
        return column.cast(pl.List(pl.String)).list.join("; ")
    return column


def _of_one_type(ours: pl.Series, theirs: pl.Series) -> tuple[pl.Series, pl.Series]:
    """Both columns as numbers if both are numeric, else as text; a column of nulls takes the type of the other."""
    numeric = all(side.dtype.is_numeric() or side.null_count() == side.len() for side in (ours, theirs))
    kind = pl.Float64 if numeric else pl.String
    return ours.cast(kind), theirs.cast(kind)


def _distances(ours: pl.Series, theirs: pl.Series) -> pl.Series:
    """``distance`` of every row."""
    unequal = pl.lit(INCOMPARABLE)
    if ours.dtype != pl.String:
        unequal = pl.lit((ours - theirs).abs().fill_nan(INCOMPARABLE).fill_null(INCOMPARABLE))
    return pl.select(pl.when(ours.eq_missing(theirs)).then(0.0).otherwise(unequal)).to_series()


def same_except_times(pair: RunPair) -> bool:
    """Whether two tables hold the same frames with the same results, apart from the time columns."""
    ours, theirs = (_rows(run, by_segment=False) for run in (pair.base, pair.new))
    return ours.drop(TIME_COLUMNS, strict=False).equals(theirs.drop(TIME_COLUMNS, strict=False))
