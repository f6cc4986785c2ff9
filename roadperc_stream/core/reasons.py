"""The reasons of many frames: those that differ in their numbers alone are one, with how many frames gave it."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from roadperc_stream.core.config import STAGES
from roadperc_stream.schemas.roles import ROLES

_NUMBER: Final = re.compile(r"-?\d+(\.\d+)?")
_LACKED: Final = re.compile(r"\b(?:no|neither|nor) (\w+)")
"""How a stage says which inputs it lacks."""
_OFF: Final = "switched off"
_OF_STAGES: Final = (*STAGES, "drivable")
"""Before a reason's first colon: any other word there is an input's."""
_MOST_TOLD: Final = 4


@dataclass(frozen=True)
class Reason:
    """One of the texts of a reason, in how many frames it was given, and whether its numbers vary among them."""

    text: str
    frames: int
    varies: bool = False

    def __str__(self) -> str:
        return f"{self.text} (numbers vary)" if self.varies else self.text


Reasons = dict[str, Reason]
"""By the text with its numbers replaced."""


def grouped(counts: Mapping[str, int]) -> Reasons:
    """The reasons of frames, of which each gives a reason once; the commonest text stands for a reason.

    Args:
        counts: frames per text.
    """
    texts = sorted(counts, key=lambda text: (-counts[text], text))
    return merged({_NUMBER.sub("#", text): Reason(text, counts[text])} for text in texts)


def merged(parts: Iterable[Mapping[str, Reason]]) -> Reasons:
    """The reasons of several lots of frames; the first one's text stands for a reason."""
    whole: Reasons = {}
    for part in parts:
        for kind, reason in part.items():
            known = whole.get(kind, Reason(reason.text, 0))
            varies = known.varies or reason.varies or known.text != reason.text
            whole[kind] = Reason(known.text, known.frames + reason.frames, varies)
    return whole


def ranked(reasons: Mapping[str, Reason]) -> Reasons:
    """The most frequent first; of equals those of inputs, of which those of stages often follow."""
    order = sorted(reasons.items(), key=lambda found: (-found[1].frames, _is_of_stage(found[1]), found[1].text))
    return dict(order)


def throughout(reasons: Mapping[str, Reason], frames: int, filled: Collection[str]) -> tuple[str, ...]:
    """What held in all frames of a replay and is no mere lack of an input, in words; a few where there are many.

    Left out are stages that are switched off, inputs for which the log has no topic, and what follows from another
    reason that is told.

    Args:
        reasons: of the frames.
        frames: how many there are.
        filled: roles that a topic of the log fills.
    """
    always = [reason for reason in ranked(reasons).values() if reason.frames == frames]
    apart = [reason for reason in always if _OFF not in reason.text and not _lacks_role(reason.text, filled)]
    causes = [f": {reason.text.partition(': ')[2]}" for reason in apart]
    told = [str(reason) for reason in apart if not _follows(reason.text, causes)]
    where = f"in all {frames} frames" if frames > 1 else "in the only frame"
    rest = len(told) - _MOST_TOLD
    more = (f"{where}: {rest} more reason{'s' * (rest > 1)}, which roadperc-report lists",) if rest > 0 else ()
    return (*(f"{where}: {text}" for text in told[:_MOST_TOLD]), *more)


def _is_of_stage(reason: Reason) -> bool:
    return reason.text.partition(":")[0] in _OF_STAGES


def _lacks_role(text: str, filled: Collection[str]) -> bool:
    return any(word in ROLES and word not in filled for word in _LACKED.findall(text))


def _follows(text: str, causes: Iterable[str]) -> bool:
    """Whether a text hands on another one's cause, as ``lanes: no surface: ...`` that of ``surface: ...``."""
    after_stage = text.partition(": ")[2]
    return any(after_stage.endswith(cause) for cause in causes)
