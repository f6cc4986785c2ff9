"""Numbers and words over time."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import rerun as rr

from roadperc_stream.view.rerun.entry import Entry, SceneState

STATES: Final = ("_status", "_source", "_class")
"""How the metrics end that are words."""
MISSING: Final = "missing"
_IDENTIFIERS: Final = ("frame", "stamp_ns")
_LEVELS: Final = ("INFO", "DEBUG", "INFO", "WARN", "ERROR", "CRITICAL")
"""Rerun's words for foxglove.Log's levels, whose first is unknown."""


def metrics(entity: str, message: Any, world: SceneState) -> Iterator[Entry]:
    """Every number of a roadperc.FrameMetrics as a curve, its words as states, and the reasons for what is unknown."""
    for field, value in message.ListFields():
        if isinstance(value, int | float) and field.name not in _IDENTIFIERS:
            yield Entry(f"{entity}/{field.name}", rr.Scalars(float(value)))
    for name, word in _words(message).items():
        if word or world.words.get(name):  # an empty one ends the state before
            yield Entry(f"{entity}/{name}", rr.StateChange(state=word))
        world.words[name] = word
    yield from _reasons(entity, "; ".join(message.reasons), world)


def _words(message: Any) -> dict[str, str]:
    """The words of a frame, empty where it has none; roles without a message in one."""
    states = (field.name for field in message.DESCRIPTOR.fields if field.name.endswith(STATES))
    return {name: getattr(message, name) for name in states} | {MISSING: ", ".join(message.missing)}


def _reasons(entity: str, reasons: str, world: SceneState) -> Iterator[Entry]:
    """A line where they change: it holds until the next one."""
    if reasons != world.words.get("reasons", ""):
        line = rr.TextLog(reasons, level="WARN") if reasons else rr.TextLog("nothing is missing any more", level="INFO")
        yield Entry(f"{entity}/reasons", line)
    world.words["reasons"] = reasons


def times(entity: str, times_ms: Mapping[str, float]) -> Iterator[Entry]:
    """Milliseconds of the stages that ran."""
    for column, value in times_ms.items():
        yield Entry(f"{entity}/{column}", rr.Scalars(value))


def log_line(entity: str, message: Any) -> Iterator[Entry]:
    """A line of a foxglove.Log."""
    yield Entry(entity, rr.TextLog(message.message, level=_LEVELS[message.level]))
