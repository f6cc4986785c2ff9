"""How far the fields of two runs agree, frame by frame."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Final, Literal

Value = float | int | str | bool | None
State = Literal["identical", "within tolerance", "differs"]
ABSENT: Final = math.inf
"""Distance of a value from none, or from a value of another kind or text."""


@dataclass(frozen=True)
class Difference:
    """Both values of a field in one frame; ``place`` is the field with the indices of its lists."""

    run: str
    frame: int
    stamp_ns: int
    place: str
    reference: Value
    candidate: Value


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

    def of_run(self, run: str) -> "Agreement":
        """The same, with the run its first difference is in."""
        return replace(self, first=self.first and replace(self.first, run=run))

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
