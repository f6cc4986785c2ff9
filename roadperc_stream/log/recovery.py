"""What was saved of a damaged log and what was lost, as a repaired log records it."""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import msgspec

from roadperc_stream.log.records import RECOVERY_RECORD, Metadata
from roadperc_stream.system.time import ns_to_seconds

_VERSION: Final = "1"
_GAPS_LISTED: Final = 5
_TOPICS_LISTED: Final = 8
_GAPS: Final = list[tuple[int | None, int | None, dict[str, int]]]


@dataclass(frozen=True)
class LostSpan:
    """Log times between which messages were lost, both included, None where nothing says so, and how many by topic."""

    first_ns: int | None
    last_ns: int | None
    messages: Mapping[str, int]


@dataclass(frozen=True)
class Recovery:
    """What was saved of a damaged log, and what was lost."""

    saved: int
    """Messages."""
    lost: Mapping[str, int]
    """Messages by topic, those that the log says it had."""
    exact: bool
    """Whether the log says how many it had: else more may be lost than those."""
    gaps: tuple[LostSpan, ...]

    @classmethod
    def of_records(cls, metadata: Iterable[Metadata]) -> "Recovery | None":
        """What a repaired log says of itself, or those of its parts that were; None of any other log."""
        found = [cls._of_values(dict(record.values)) for record in metadata if record.name == RECOVERY_RECORD]
        total: Recovery | None = None
        for recovery in found:
            if recovery is not None:
                total = recovery.after(total, saved=recovery.saved + (total.saved if total else 0))
        return total

    @classmethod
    def _of_values(cls, values: Mapping[str, str]) -> "Recovery | None":
        if values.get("version") != _VERSION:
            return None
        try:
            gaps = tuple(LostSpan(*gap) for gap in msgspec.json.decode(values["gaps"], type=_GAPS))
            lost = msgspec.json.decode(values["lost"], type=dict[str, int])
            return cls(int(values["saved"]), lost, values["exact"] == "true", gaps)
        except (KeyError, ValueError, RecursionError, msgspec.MsgspecError):
            return None

    def to_record(self) -> Metadata:
        """As ``of_records`` reads it."""
        values = {
            "version": _VERSION,
            "saved": str(self.saved),
            "lost": json.dumps(self.lost),
            "exact": json.dumps(self.exact),
            "gaps": json.dumps([[gap.first_ns, gap.last_ns, dict(gap.messages)] for gap in self.gaps]),
        }
        return Metadata(RECOVERY_RECORD, tuple(values.items()))

    def ending(self, last_ns: int | None) -> "Recovery":
        """With an end of the gaps that have none, unless they begin behind it."""
        if last_ns is None:
            return self
        return replace(self, gaps=tuple(_ending(gap, last_ns) for gap in self.gaps))

    def of_at_most(self, gaps: int) -> "Recovery":
        """With so many gaps, of which the last stands for all behind it, too."""
        if len(self.gaps) <= gaps:
            return self
        return replace(self, gaps=(*self.gaps[: gaps - 1], _as_one(self.gaps[gaps - 1 :])))

    def after(self, earlier: "Recovery | None", saved: int) -> "Recovery":
        """With what an earlier repair of the same log, or that of its part before, had lost."""
        if earlier is None:
            return self
        lost = dict(Counter(earlier.lost) + Counter(self.lost))
        return Recovery(saved, lost, self.exact and earlier.exact, (*earlier.gaps, *self.gaps))

    def lines(self, first_ns: int | None) -> Iterator[str]:
        """In words: a line on all, a line on each of the first gaps.

        Args:
            first_ns: log time of the first message, from which seconds count.
        """
        lost = sum(self.lost.values())
        number = f"{lost}" if self.exact else f"at least {lost}" if lost else "an unknown number"
        listed = "" if len(self.gaps) == 1 and self.gaps[0].messages == self.lost else _listed(self.lost)
        yield f"{self.saved} messages saved, {number} lost{listed}"
        for gap in self.gaps[:_GAPS_LISTED]:
            yield f"lost {_between(gap, first_ns)}{_listed(gap.messages)}"
        if len(self.gaps) > _GAPS_LISTED:
            yield f"and {len(self.gaps) - _GAPS_LISTED} gaps more"


def _ending(gap: LostSpan, last_ns: int) -> LostSpan:
    is_open = gap.last_ns is None and (gap.first_ns is None or gap.first_ns <= last_ns)
    return replace(gap, last_ns=last_ns) if is_open else gap


def _as_one(gaps: Sequence[LostSpan]) -> LostSpan:
    firsts, lasts = [gap.first_ns for gap in gaps], [gap.last_ns for gap in gaps]
    messages = Counter[str]()
    for gap in gaps:
        messages.update(gap.messages)
    first_ns = None if None in firsts else min(ns for ns in firsts if ns is not None)
    last_ns = None if None in lasts else max(ns for ns in lasts if ns is not None)
    return LostSpan(first_ns, last_ns, dict(messages))


def _listed(messages: Mapping[str, int]) -> str:
    named = [f"{topic} {number}" for topic, number in list(messages.items())[:_TOPICS_LISTED]]
    more = ["..."] if len(messages) > _TOPICS_LISTED else []
    return f": {', '.join((*named, *more))}" if messages else ""


def _between(gap: LostSpan, first_ns: int | None) -> str:
    if gap.first_ns is None and gap.last_ns is None:
        return "at an unknown time"
    parts = [
        f"{word} {_at(time_ns, first_ns)}"
        for word, time_ns in (("from", gap.first_ns), ("to", gap.last_ns))
        if time_ns is not None
    ]
    return " ".join(parts)


def _at(time_ns: int, first_ns: int | None) -> str:
    return f"{time_ns} ns" if first_ns is None else f"{ns_to_seconds(time_ns - first_ns):.3f} s ({time_ns} ns)"
