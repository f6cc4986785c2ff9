"""Errors of pydantic in words for users."""

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Final

from roadperc_stream.system.text import in_brief

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

_EXPECTED: Final = {
    **dict.fromkeys(("tuple_type", "list_type"), "a list"),
    **dict.fromkeys(("dict_type", "mapping_type", "model_type"), "keys with values"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    "string_type": "a text",
    "string_pattern_mismatch": "a text of the form {pattern}",
    "too_short": "at least {min_length} values",
    "too_long": "at most {max_length} values",
    "literal_error": "one of {expected}",
    "union_tag_invalid": "one of {expected_tags}",
    "json_invalid": "JSON ({error})",
}
"""The expected value by the type of pydantic's error; others are in its message. The braces are keys of its context."""
_MEMBERS: Final = frozenset({"int", "float", "str", "bool"})


def key_of(place: Sequence[int | str], without: Collection[int | str] = ()) -> str:
    """The place of an error as a key, such as ``annotations[0].image_id``, without the members of unions."""
    parts = [part for part in place if part not in without and part not in _MEMBERS and "[" not in str(part)]
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).removeprefix(".")


def complaint(error: "ErrorDetails", most: int = 200) -> str:
    """The expected and the found value, such as ``expected a number, found 'x'``; ``missing`` without a value.

    ``most`` is the largest number of characters of the found value.
    """
    kind, context = error["type"], error.get("ctx", {})
    if kind in ("missing", "union_tag_not_found"):
        return "missing"
    if kind == "value_error":
        return str(context["error"])
    said = error["msg"].removeprefix("Input should be ")
    words = _EXPECTED[kind].format(**context) if kind in _EXPECTED else said
    return f"expected {words}, found {in_brief(context.get('tag', error['input']), most)}"
