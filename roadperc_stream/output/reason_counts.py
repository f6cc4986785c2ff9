"""The reasons of many frames: those of one kind are counted together, with how many frames gave them."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from roadperc_stream.config import STAGES
from roadperc_stream.model import MISSING_ROLES, Reason, ReasonKind, parse_reason
from roadperc_stream.model.reason import UNUSABLE

_STAGES: Final = (*STAGES, "drivable")
"""Sources that are stages: any other is an input."""
_MOST_REPORTED: Final = 4


@dataclass(frozen=True)
class ReasonCount:
    """One of the texts of a kind of reason, in how many frames it was given, and whether its numbers vary."""

    text: str
    frames: int
    varies: bool = False

    def __str__(self) -> str:
        return f"{self.text} (numbers vary)" if self.varies else self.text


ReasonCounts = dict[ReasonKind, ReasonCount]


def of_frame(reasons: Iterable[Reason]) -> ReasonCounts:
    """The reasons of one frame."""
    return {reason.kind: ReasonCount(str(reason), 1) for reason in reasons}


def grouped(counts: Mapping[str, int]) -> ReasonCounts:
    """The reasons of frames as a table has them; the commonest text stands for its kind.

    Args:
        counts: frames per text, of which each frame gives a kind once.
    """
    texts = sorted(counts, key=lambda text: (-counts[text], text))
    return merged({parse_reason(text).kind: ReasonCount(text, counts[text])} for text in texts)


def merged(parts: Iterable[Mapping[ReasonKind, ReasonCount]]) -> ReasonCounts:
    """The reasons of several lots of frames; the first one's text stands for a kind."""
    whole: ReasonCounts = {}
    for part in parts:
        for kind, count in part.items():
            known = whole.get(kind, ReasonCount(count.text, 0))
            varies = known.varies or count.varies or known.text != count.text
            whole[kind] = ReasonCount(known.text, known.frames + count.frames, varies)
    return whole


def ranked(counts: Mapping[ReasonKind, ReasonCount]) -> ReasonCounts:
    """The most frequent first; of equals those of inputs, of which those of stages often follow."""
    return dict(sorted(counts.items(), key=lambda item: (-item[1].frames, _source(item[0]) in _STAGES, item[1].text)))


def throughout(counts: Mapping[ReasonKind, ReasonCount], frames: int, filled: Collection[str]) -> tuple[str, ...]:
    """The reasons that held in all frames of a replay, in words, and messages that could not be used in some.

    Of many a few are named. Left out are stages that are switched off, inputs for which the log has no topic, and what
    follows from another reason that is reported.

    Args:
        counts: of the frames.
        frames: how many there are.
        filled: roles that a topic of the log fills.
    """
    always = {kind: count for kind, count in ranked(counts).items() if count.frames == frames}
    unexpected = {kind: count for kind, count in always.items() if not _is_expected(kind, filled)}
    # A reason follows where its cause, or its cause's, is itself among the reasons.
    follows = {kind for kind in unexpected if any(kind[k:] in unexpected for k in range(1, len(kind)))}
    first = [str(count) for kind, count in unexpected.items() if kind not in follows]
    where = f"in all {frames} frames" if frames > 1 else "in the only frame"
    rest = len(first) - _MOST_REPORTED
    more = (f"{where}: {rest} more reason{'s' * (rest > 1)}, which roadperc-report lists",) if rest > 0 else ()
    return (*(f"{where}: {text}" for text in first[:_MOST_REPORTED]), *more, *_unusable_in_some(counts, frames))


def _unusable_in_some(counts: Mapping[ReasonKind, ReasonCount], frames: int) -> tuple[str, ...]:
    """Messages of some frames that could not be used, the most frequent first."""
    some = ranked({kind: n for kind, n in counts.items() if n.frames < frames and kind[0][1] in UNUSABLE})
    found = [f"in {count.frames} of {frames} frames: {count}" for count in some.values()]
    rest = len(found) - _MOST_REPORTED
    more = (f"{rest} more kinds of messages that cannot be used, which roadperc-report lists",) if rest > 0 else ()
    return (*found[:_MOST_REPORTED], *more)


def _source(kind: ReasonKind) -> str:
    return kind[0][0]


def _is_expected(kind: ReasonKind, filled: Collection[str]) -> bool:
    """Whether the user switched a stage off, or the log has no topic for an input."""
    codes = {code for _, code, *_ in kind}
    missing = {role for code, roles in MISSING_ROLES.items() if code in codes for role in roles}
    return "switched_off" in codes or not missing.issubset(filled)
