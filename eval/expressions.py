"""Columns and polars SQL expressions: groups of ``--by``, conditions of ``find`` and of criteria.

Polars reads files and addresses while it parses an expression with a subquery, so the text is checked before.
"""

import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.system.text import listed, nearest

from .runs import first_line

_ROWS: Final = 2
"""Rows on which an expression is tried."""
_MOST_CHARACTERS: Final = 1000
"""Polars takes minutes for an expression of 10,000 characters, and a longer one can end the process."""
_DIGITS: Final = 6
"""Significant digits of a number in the name of a group."""
_TOKEN: Final = re.compile(
    r"""\s*(?:
    (?P<constant>'(?:[^']|'')*'|(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|"[^"]+")
    |(?P<between>is\s+(?:not\s+)?distinct\s+from\b|<=|>=|<>|!=|==|\|\||::|//(?!\*)|/(?![/*])|-(?!-)|!?~\*?|[+*%<>=,])
    |(?P<open>[(\[]|case\b)|(?P<close>[)\]]|end\b)
    |(?P<name>[^\W\d]\w*)
    )\s*""",
    re.VERBOSE | re.IGNORECASE,
)
"""A part of an expression; a constant includes a quoted column. Comments are no part."""
_OPERATORS: Final = re.compile("and|or|xor|not|in|is|between|like|ilike|rlike|regexp|when|then|else|as")
_FUNCTIONS: Final = """
abs ceil ceiling floor round trunc truncate sign sqrt cbrt exp ln log log2 log10 log1p pow power mod div degrees radians
sin cos tan cot asin acos atan atan2 greatest least coalesce nullif ifnull if cast try_cast lower upper initcap trim
ltrim rtrim length char_length character_length octet_length starts_with ends_with strpos left right substr substring
regexp_like concat array_length array_contains array_get array_mean any all avg count max median min stddev sum variance
"""
"""Functions of values and columns; none reads a file, or makes a text or a list of any length."""
_KNOWN: Final = frozenset(_FUNCTIONS.split())
_CLOSING: Final = {"(": ")", "[": "]", "case": "end"}


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
    _require_scalar(text)
    try:
        return pl.sql_expr(text)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise ValueError(first_line(error)) from error


def _require_scalar(text: str) -> None:
    """Check that a text is one expression of columns, constants, operators and ``_FUNCTIONS``, not a query.

    Each query has two names without an operator between them, such as ``select x`` or ``from x``.

    Raises:
        ValueError: it is not; the message has the first wrong part.
    """
    at, ended, opened = 0, False, list[str]()
    while at < len(text):
        found = _TOKEN.match(text, at)
        if found is None:
            raise ValueError(f"unexpected {text[at:].strip()[:20]!r}")
        word, kind, at = found[0].strip().lower(), found.lastgroup, found.end()
        is_called = kind == "name" and text.startswith("(", at)
        is_operator = kind == "between" or _OPERATORS.fullmatch(word) is not None
        if is_called and not is_operator and word not in _KNOWN:
            near = nearest(word, _KNOWN)
            raise ValueError(f"no function {word}; {f'did you mean {near}?' if near else 'docs/checks.md lists them'}")
        if ended and not is_operator and kind != "close" and word != "[":
            raise ValueError(f"unexpected {word[:20]!r} after a value; expected one expression, without a query")
        if kind == "open":
            opened.append(_CLOSING[word])
        elif kind == "close" and (not opened or opened.pop() != word or (word == ")" and not ended)):
            raise ValueError(f"unexpected {word!r}")
        ended = kind == "close" or not (is_operator or is_called or kind == "open")
    if opened:
        raise ValueError(f"expected {opened[-1]!r} at the end")


def on_empty_rows(found: pl.Expr, schema: Mapping[str, pl.DataType]) -> pl.Series:
    """The value of an expression on ``_ROWS`` rows of nulls in the columns that it reads.

    Raises:
        ValueError: the expression does not fit the types of its columns.
    """
    read = {name: schema[name] for name in found.meta.root_names() if name in schema}
    try:
        rows = pl.DataFrame([[None] * len(read)] * _ROWS, schema=read, orient="row")  # clear() takes much longer
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
