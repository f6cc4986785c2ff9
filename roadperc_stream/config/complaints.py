"""Errors of pydantic in words for users."""

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Final

from roadperc_stream.system.text import in_brief

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

_TABLES: Final = frozenset({"dict_type", "mapping_type", "model_type"})
"""Errors whose text names a class of this program."""
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
    if kind == "union_tag_invalid":
        return f"expected one of {context['expected_tags']}, found {in_brief(context['tag'], most)}"
    said = "expected keys with values" if kind in _TABLES else error["msg"].replace("Input should be", "expected")
    return f"{said}, found {in_brief(error['input'], most)}"
