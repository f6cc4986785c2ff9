"""Counts the reasons of many frames by their kind."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from roadperc_stream.config import STAGES
from roadperc_stream.model import MISSING_ROLES, Reason, ReasonKind
from roadperc_stream.model.reason import UNUSABLE

_STAGES: Final = (*STAGES, "drivable")
"""Sources that are stages; all others are inputs."""
_IN_SOME: Final = UNUSABLE | {"image_frozen"}
"""Codes that are reported even if they held in some frames only."""
_MOST_REPORTED: Final = 6


@dataclass(frozen=True)
class ReasonCount:
    """A reason for its kind, the kind's number of frames, and whether its numbers vary."""

    reason: Reason
    frames: int
    varies: bool = False

    def __str__(self) -> str:
        return f"{self.reason}{self._varying}"

    @property
    def text(self) -> str:
        """The sentence without its source."""
        return f"{self.reason.text}{self._varying}"

    @property
    def _varying(self) -> str:
        return " (numbers vary)" if self.varies else ""


ReasonCounts = dict[ReasonKind, ReasonCount]


def of_frame(reasons: Iterable[Reason]) -> ReasonCounts:
    """The reasons of one frame."""
    return {reason.kind: ReasonCount(reason, 1) for reason in reasons}


def grouped(counts: Iterable[tuple[Reason, int]]) -> ReasonCounts:
    """Group the reasons of a table by kind; the most common one represents its kind.

    ``counts`` are reasons and their frames; a frame has a kind at most once.
    """
    first = sorted(counts, key=lambda item: (-item[1], str(item[0])))
    return merged({reason.kind: ReasonCount(reason, frames)} for reason, frames in first)


def merged(groups: Iterable[Mapping[ReasonKind, ReasonCount]]) -> ReasonCounts:
    """Merge the counts of several groups of frames; the first reason represents its kind."""
    found: ReasonCounts = {}
    for counts in groups:
        for kind, count in counts.items():
            known = found.get(kind, ReasonCount(count.reason, 0))
            varies = known.varies or count.varies or str(known.reason) != str(count.reason)
            found[kind] = ReasonCount(known.reason, known.frames + count.frames, varies)
    return found


def ranked(counts: Mapping[ReasonKind, ReasonCount]) -> ReasonCounts:
    """The most frequent first; inputs before stages, since an input is often the cause."""

    def rank(item: tuple[ReasonKind, ReasonCount]) -> tuple[int, bool, str]:
        reason = item[1].reason
        return -item[1].frames, reason.source in _STAGES, str(reason)

    return dict(sorted(counts.items(), key=rank))


def throughout(counts: Mapping[ReasonKind, ReasonCount], frames: int, filled: Collection[str]) -> tuple[str, ...]:
    """Texts of the reasons in all frames of a replay, and of inputs that could not be used in some frames.

    The most frequent are listed, the others are only counted. Stages that are switched off, inputs without a topic in
    the log, and consequences of a listed reason are left out. ``counts`` are those of all ``frames``; ``filled`` are
    the roles that have a topic.
    """
    unexpected = {kind: count for kind, count in ranked(counts).items() if not _is_expected(kind, filled)}
    always = {kind for kind, count in unexpected.items() if count.frames == frames}
    # A reason is a consequence if its cause, or the cause of its cause, is also a reason.
    follows = {kind for kind in always if any(kind[k:] in always for k in range(1, len(kind)))}
    listed = (count for kind, count in unexpected.items() if kind in always - follows or kind[0][1] in _IN_SOME)
    lines = [f"in {_share(count.frames, frames)}: {count}" for count in listed]
    rest = len(lines) - _MOST_REPORTED
    more = (f"{rest} more reason{'s' * (rest > 1)}, which roadperc-report lists",) if rest > 0 else ()
    return (*lines[:_MOST_REPORTED], *more)


def _share(count: int, frames: int) -> str:
    if count < frames:
        return f"{count} of {frames} frames"
    return f"all {frames} frames" if frames > 1 else "the only frame"


def _is_expected(kind: ReasonKind, filled: Collection[str]) -> bool:
    """Whether the user switched off the stage, or the log has no topic for an input."""
    codes = {code for _, code, *_ in kind}
    missing = {role for code, roles in MISSING_ROLES.items() if code in codes for role in roles}
    return "switched_off" in codes or not missing.issubset(filled)
