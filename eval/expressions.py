"""Columns and polars SQL expressions that group rows, as in ``--by``."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError

from .quantities import listed
from .runs import first_line

_ROWS: Final = 2
"""Rows on which an expression is tried."""
_MOST_CHARACTERS: Final = 1000
"""Polars takes minutes for an expression of 10,000 characters, and a longer one can end the process."""
_DIGITS: Final = 6
"""Significant digits of a number in the name of a group."""


def expression(text: str) -> pl.Expr:
    """A column by its name, or a polars SQL expression on columns.

    Raises:
        TableError: the text is neither.
    """
    if text.isidentifier():
        return pl.col(text)
    try:
        return parsed(text)
    except ValueError as error:
        raise TableError(
            f"--by {text[:_MOST_CHARACTERS]}: is neither a column nor a polars SQL expression ({error}); "
            'expected one such as config or "floor(distance_m / 10) * 10"'
        ) from error


def parsed(text: str) -> pl.Expr:
    """A polars SQL expression.

    Raises:
        ValueError: it is not one, or too long; the message says why.
    """
    if len(text) > _MOST_CHARACTERS:
        raise ValueError(f"{len(text)} characters, expected {_MOST_CHARACTERS} at most")
    try:
        return pl.sql_expr(text)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise ValueError(first_line(error)) from error


def on_empty_rows(found: pl.Expr, schema: Mapping[str, pl.DataType]) -> pl.Series:
    """The value of an expression on ``_ROWS`` rows of nulls.

    Raises:
        ValueError: the expression does not fit the types of its columns.
    """
    try:
        rows = pl.DataFrame([[None] * len(schema)] * _ROWS, schema=schema, orient="row")  # clear() takes much longer
        return rows.select(value=found)["value"]
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise ValueError(first_line(error)) from error


def roots(text: str) -> list[str]:
    """The columns that an expression reads."""
    return expression(text).meta.root_names()


def unknown(text: str, name: str, known: Iterable[str], where: str) -> TableError:
    """The error for a column that does not exist; it lists similar columns."""
    column = "" if text == name else f" {name}"
    return TableError(f"--by {text}: no column{column} of {where}; {similar(text, name, known)}")


def similar(text: str, name: str, known: Iterable[str]) -> str:
    """The known columns that are similar to a wrong one of an expression; else that a text needs quotes."""
    names = sorted(set(known))
    word = name.partition("_")[0]
    near = get_close_matches(name, names, 4) + [other for other in names if word in other]
    if near:
        return f"similar columns: {listed(list(dict.fromkeys(near)))}"
    quotes = "" if text == name else f"if it is a text, write '{name}' in single quotes; "
    return f"{quotes}docs/metrics.md lists the {len(names)} columns"


def require_roots(by: Iterable[str], known: Iterable[str], others: Iterable[str], where: str) -> None:
    """Check that the columns of expressions are among the known ones; an error also lists ``others``.

    Raises:
        TableError: a column does not exist.
    """
    names = set(known)
    lacking = [(text, name) for text in by for name in roots(text) if name not in names]
    if lacking:
        raise unknown(*lacking[0], names.union(others), where)


def as_key(text: str, schema: Mapping[str, pl.DataType]) -> pl.Expr:
    """The value of an expression as text, for the keys and names of groups; null if empty.

    Raises:
        TableError: the expression does not fit the types of its columns, or is one value for all rows.
    """
    found = expression(text).alias(key_name(text))
    try:
        rows = on_empty_rows(found, schema)
    except ValueError as error:
        raise TableError(f"--by {text}: cannot be computed from the table's columns: {error}") from error
    if rows.len() != _ROWS:
        raise TableError(f"--by {text}: gives one value for all rows; expected a value for each row")
    kind = rows.dtype
    is_list = isinstance(kind, pl.List)
    found = found.round_sig_figs(_DIGITS) if kind.is_float() else found
    shown = found.cast(pl.List(pl.String)).list.join("; ") if is_list else found.cast(pl.String)
    return pl.when(shown.str.len_bytes() > 0).then(shown).alias(key_name(text))


def key_name(text: str) -> str:
    """Name of a key's column; the table's own column may have another type."""
    return f"by {text}"
