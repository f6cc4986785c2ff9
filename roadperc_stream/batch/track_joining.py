"""Names of tracks through a log that was replayed in parts: what two parts see in a frame that both have is one object.

Each part names its tracks from 1 on. A track keeps the name of the part before where both see it in a frame near the
seam; every other one gets a number that none before it has.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from roadperc_stream.core.datatypes import Box

_SAME: Final = 0.5
"""Intersection over union from which on two boxes of a label that no detector gave are of one object."""


@dataclass(frozen=True)
class TrackedBox:
    """Where a track is in a frame."""

    name: str
    label: str
    box_px: Box


Seen = Sequence[TrackedBox]


def joined_names(common: Iterable[tuple[Seen, Seen]], names: Iterable[str], largest: int) -> dict[str, str]:
    """The name of each track of a part in the whole log.

    Args:
        common: what the part before and the part see in each frame that both have, those nearest to the seam first.
        names: of the part's tracks, in the order in which they get new ones.
        largest: number of a track so far.
    """
    known: dict[str, str] = {}
    for before, after in common:
        for one, other in _pairs(before, after):
            if other not in known and one not in known.values():
                known[other] = one
    new = (name for name in dict.fromkeys(names) if name not in known)
    return known | {name: str(number) for number, name in enumerate(new, start=largest + 1)}


def largest_number(names: Iterable[str | None]) -> int:
    """The largest number among the names of tracks; 0 where there is none."""
    return max((int(name) for name in set(names) if name is not None and name.isdecimal()), default=0)


def _pairs(before: Seen, after: Seen) -> list[tuple[str, str]]:
    """Names of the same object in both parts: the same detection, else the two boxes that overlap most."""
    places = defaultdict[tuple[str, Box], list[str]](list)
    for item in before:
        places[item.label, item.box_px].append(item.name)
    found = [(places[o.label, o.box_px].pop(0), o.name) for o in after if places[o.label, o.box_px]]
    ours, theirs = ({names[side] for names in found} for side in (0, 1))
    carried = _overlapping([o for o in before if o.name not in ours], [o for o in after if o.name not in theirs])
    for _, one, other in sorted(carried, reverse=True):
        if one not in ours and other not in theirs:
            found.append((one, other))
            ours.add(one)
            theirs.add(other)
    return found


def _overlapping(before: Seen, after: Seen) -> list[tuple[float, str, str]]:
    """By how much boxes of a label overlap, and the names of both, where it is enough."""
    overlaps = ((b.box_px.overlap(a.box_px), b.name, a.name) for b in before for a in after if b.label == a.label)
    return [found for found in overlaps if found[0] >= _SAME]


def renamed(names: Iterable[str | None], inside: Iterable[bool], new: Mapping[str, str]) -> list[str | None]:
    """A column of names, the new ones where it is ``inside`` what they are of."""
    return [
        new.get(name, name) if here and name is not None else name for name, here in zip(names, inside, strict=True)
    ]
