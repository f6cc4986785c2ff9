"""The definition of a column: its meaning, its label, and which values are better."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final, Literal, TypeVar, get_type_hints

COUNT: Final = "count"
RATIO: Final = "ratio"
UNITLESS: Final = frozenset({"", COUNT, RATIO})
RELEVANT: Final = {"m": 0.01, "deg": 0.05, "s": 0.05, "px": 0.05, "m/s": 0.1, RATIO: 0.005, COUNT: 0.1}
"""Smallest relevant effect by unit, unless a column has its own."""
Better = Literal["high", "low", "near 0", ""]
"""The better side; empty if neither is better."""
Row = TypeVar("Row")


@dataclass(frozen=True)
class Column:
    """A column of a table. It annotates the field of the row that holds its value.

    ``meaning`` is the formula, and ``null`` says when there is no value. Reports show the value with ``label``,
    ``unit`` and ``decimals``; without a label they omit it. ``compares_coverage`` is true if a frame without a value is
    a loss that no other column shows.

    A mean or a quantile that changes by less than ``relevant``, in the column's unit, counts as unchanged; by default
    that of the unit, else 0. A frame is bad if the absolute value is beyond ``limit``: above it, or below it if high is
    better.
    """

    meaning: str
    unit: str = ""
    null: str = ""
    label: str = ""
    decimals: int = 0
    better: Better = ""
    compares_coverage: bool = True
    relevant: float = math.nan
    limit: float | None = None

    def __post_init__(self) -> None:
        """Take the relevant effect of the unit, unless the column has its own."""
        if math.isnan(self.relevant):
            object.__setattr__(self, "relevant", RELEVANT.get(self.unit, 0.0))


def columns_of(row_type: type) -> Mapping[str, Column]:
    """Return the columns of a row, or of a group of columns, by name and in the table's order.

    Raises:
        TypeError: a field has no Column in its annotation.
    """
    hints = get_type_hints(row_type, include_extras=True)
    return {field.name: _annotation(field.name, hints[field.name]) for field in fields(row_type)}


def _annotation(name: str, hint: Any) -> Column:
    found = [part for part in getattr(hint, "__metadata__", ()) if isinstance(part, Column)]
    if len(found) != 1:
        raise TypeError(f"{name}: expected a column's definition in its annotation")
    return found[0]


def row_of(row_type: type[Row], *groups: object) -> Row:
    """Return a row made of its groups of columns, which are instances of the row's base classes."""
    return row_type(**{name: value for group in groups for name, value in vars(group).items()})
