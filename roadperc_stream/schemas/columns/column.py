"""What is known of a column: how it is shown, which values are better, what it means."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final, Literal, TypeVar, get_type_hints

COUNT: Final = "count"
RATIO: Final = "ratio"
UNITLESS: Final = frozenset({"", COUNT, RATIO})
Better = Literal["high", "low", "near 0", ""]
"""On which side good values lie; empty where neither side is better."""
Row = TypeVar("Row")


@dataclass(frozen=True)
class Column:
    """A column of a table. It annotates the field of the row that holds its value.

    ``meaning`` and ``null`` are the definition: the formula, and when there is no value. ``label``, with ``unit`` and
    ``decimals`` behind the point, is how reports name a number; empty for what they do not list. ``compares_coverage``
    says that a frame without a value is a loss which no neighbouring column shows as well.
    """

    meaning: str
    unit: str = ""
    null: str = ""
    label: str = ""
    decimals: int = 0
    better: Better = ""
    compares_coverage: bool = True


def columns_of(row_type: type) -> Mapping[str, Column]:
    """The columns of a row, or of a group of them, by name and in the table's order.

    Raises:
        TypeError: a field of the row says nothing of itself.
    """
    hints = get_type_hints(row_type, include_extras=True)
    return {field.name: _annotation(field.name, hints[field.name]) for field in fields(row_type)}


def _annotation(name: str, hint: Any) -> Column:
    found = [part for part in getattr(hint, "__metadata__", ()) if isinstance(part, Column)]
    if len(found) != 1:
        raise TypeError(f"{name}: expected a column's definition in its annotation")
    return found[0]


def row_of(row_type: type[Row], *groups: object) -> Row:
    """A row from its groups of columns, each an instance of one of the classes the row inherits from."""
    return row_type(**{name: value for group in groups for name, value in vars(group).items()})
