"""Errors of pydantic in words for users."""

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Final

from roadperc_stream.config.settings import in_brief

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

_LIST: Final = "a list"
_TABLE: Final = "keys with values"
_WHOLE: Final = "a whole number"
_NUMBER: Final = "a number"
_EXPECTED: Final = {
    "tuple_type": _LIST,
    "list_type": _LIST,
    "dict_type": _TABLE,
    "model_type": _TABLE,
    "mapping_type": _TABLE,
    "int_type": _WHOLE,
    "int_parsing": _WHOLE,
    "int_from_float": _WHOLE,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "a text",
    "string_pattern_mismatch": "a text of the form {pattern}",
    "string_too_long": "at most {max_length} characters",
    "greater_than": "a number above {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number below {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "too_short": "at least {min_length} values",
    "too_long": "at most {max_length} values",
    "union_tag_invalid": "one of {expected_tags}",
    "literal_error": "one of {expected}",
    "json_invalid": "JSON ({error})",
}
"""The expected value by the type of pydantic's error; the braces are keys of its context."""
_MEMBERS: Final = frozenset({"int", "float", "str", "bool"})


def key_of(place: Sequence[int | str], without: Collection[int | str] = ()) -> str:
    """The place of an error as a key, such as ``annotations[0].image_id``, without the members of unions."""
    parts = [part for part in place if part not in without and part not in _MEMBERS and "[" not in str(part)]
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).removeprefix(".")


def complaint(error: "ErrorDetails", most: int = 200) -> str:
    """The expected and the found value, such as ``expected a number above 0, found -1``; ``missing`` without a value.

    ``most`` is the largest number of characters of the found value.
    """
    kind, context = error["type"], error.get("ctx", {})
    if kind in ("missing", "union_tag_not_found"):
        return "missing"
    if kind in ("value_error", "assertion_error"):
        return str(context["error"])
    context |= {name: str(context[name]).replace("'", "") for name in ("expected", "expected_tags") if name in context}
    words = _EXPECTED.get(kind, "").format(**context) or error["msg"].removeprefix("Input should be ")
    return f"expected {words}, found {in_brief(context.get('tag', error['input']), most)}"
