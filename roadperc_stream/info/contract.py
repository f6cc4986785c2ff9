"""The contract of a recording: limits that are learned from good logs, and the judgement of other logs by them."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.config.complaints import complaint, key_of
from roadperc_stream.config.settings import read_toml
from roadperc_stream.errors import ConfigError
from roadperc_stream.info.examine import examine
from roadperc_stream.info.measures import Measures, Readings
from roadperc_stream.system.files import write_whole
from roadperc_stream.system.text import in_brief, listed, nearest, number, shown
from roadperc_stream.system.time import ns_to_seconds

_HEAD: Final = """\
# The contract of a recording, learned from {names}.
# Change any limit, and delete what does not matter. A number is the most; a pair is the lowest and the highest value.
# docs/recordings.md explains the keys.
"""
_FEWEST: Final = 4
"""Messages of a topic, from which on its times are limited."""
_IRREGULAR: Final = 0.5
"""Jitter of a topic that reports events, in mean intervals."""
_LEAST_BYTES: Final = 1000
"""Mean size from which on the size of messages and their repeats are limited."""
Limit = bool | float | tuple[float, float] | tuple[str, ...]
"""The most, the lowest and the highest number, or the allowed names; a flag for ``optional``."""


@dataclass(frozen=True)
class Margin:
    """The distance of a limit from the learned values: they are multiplied, and parts are added.

    Args:
        share: of the value.
        least: in the key's unit.
        periods: of the topic's mean interval.
        factor: of the value; the lowest value is divided by it.
        side: ``most`` limits from above only, ``least`` from below only.
    """

    share: float = 0.0
    least: float = 0.0
    periods: float = 0.0
    factor: float = 1.0
    side: Literal["both", "most", "least"] = "both"

    def around(self, low: float, high: float, period_s: float) -> Limit:
        """The limits around learned values, half their difference away, rounded to a hundredth of the distance."""
        room = (high - low) / 2 + self.share * max(abs(low), abs(high)) + self.least + self.periods * period_s
        least, most = low / self.factor - room, high * self.factor + room
        if low >= 0 and not self.least:  # a size or a share
            least = max(least, 0.0)
        digits = 2 - math.floor(math.log10(max(most - high, low - least, 1e-9)))
        least, most = round(least, digits), round(most, digits)
        return most if self.side == "most" else (least, math.inf if self.side == "least" else most)


_COUNTED: Final = Margin(share=0.5, side="most")
_EQUAL: Final = Margin(side="most")
KEYS: Final[Mapping[str, Margin | None]] = {
    "optional": None,
    "types": None,
    "rate_hz": Margin(share=0.1),
    "jitter_s": Margin(share=0.5, periods=0.1, side="most"),
    "gap_s": Margin(share=0.5, periods=1.0, side="most"),
    "repeats": Margin(share=1.0, least=2.0, side="most"),
    "message_bytes": Margin(factor=4.0),
    "unreadable": _COUNTED,
    "frame_ids": None,
    "latency_s": Margin(least=0.01, periods=0.2),
    "offset_s": Margin(least=0.002, periods=0.05),
    "stamps_back": _COUNTED,
    "stamps_repeated": _COUNTED,
    "codings": None,
    "sizes": None,
    **dict.fromkeys(("fx", "fy"), Margin(share=0.01)),
    **dict.fromkeys(("cx", "cy", "baseline_m"), Margin(share=0.02)),
    **dict.fromkeys(("x_m", "y_m", "z_m"), Margin(least=0.03)),
    **dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), Margin(least=1.0)),
    "tag_tables": None,
    "road_share": Margin(factor=4.0, side="least"),
    "depth_m": Margin(factor=2.0),
    "depth_known": Margin(factor=3.0, side="least"),
    "detections": Margin(factor=4.0),
}
"""The keys of a topic, with the margin of numbers; names have none."""
KEYS_OF_LOG: Final[Mapping[str, Margin | None]] = {
    "duration_s": Margin(factor=10.0, side="least"),
    "segments": _EQUAL,
    "late": _COUNTED,
    "damages": _EQUAL,
    "findings": None,
}
_OF_TIMES: Final = ("rate_hz", "jitter_s", "gap_s")
_OF_ANY_TOPIC: Final = (*_OF_TIMES, "optional", "types", "repeats", "message_bytes", "unreadable")
_OF_FRAMES: Final = ("rate_hz", "gap_s", "latency_s", "stamps_back", "stamps_repeated")
_MAY_BE_UNKNOWN: Final = ("rate_hz", "jitter_s", "latency_s", "offset_s")
"""Keys without a value in a short log, or without images; other limits then find the fault."""


class Contract(BaseModel):
    """The content of a contract's file: limits of the whole log, and of topics, by key."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    log: Mapping[str, Limit] = Field(default_factory=dict)
    topics: Mapping[str, Mapping[str, Limit]] = Field(default_factory=dict)

    @property
    def name(self) -> str:
        """Eight hexadecimal digits of the limits."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:8]

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not self.log and not self.topics:
            raise ValueError('limits nothing: expected tables [log] and [topics."/NAME"], as --init writes them')
        for table, limits in (("log", self.log), *self.topics.items()):
            keys = KEYS_OF_LOG if limits is self.log else KEYS
            for key, limit in limits.items():
                if key not in keys:
                    near = nearest(key, keys)
                    hint = f"did you mean {near}?" if near else f"known: {', '.join(keys)}"
                    raise ValueError(f"{table}: no key {key}; {hint}")
                if expected := _unlike(key, keys[key], limit):
                    raise ValueError(f"{table}: {key}: expected {expected}, found {in_brief(limit)}")
        return self


def _unlike(key: str, margin: Margin | None, limit: Limit) -> str:
    """The expected form of a limit; empty if it has it."""
    if key == "optional":
        return "" if isinstance(limit, bool) else "true or false"
    if margin is None:
        return "" if isinstance(limit, tuple) and all(isinstance(name, str) for name in limit) else "a list of names"
    if isinstance(limit, tuple) and limit and not isinstance(limit[0], str):
        return "" if limit[0] <= limit[1] else "the lowest value first"
    is_number = isinstance(limit, float) and not math.isnan(limit)
    return "" if is_number else "a number, or the lowest and the highest"


@dataclass(frozen=True)
class MeasuredLog:
    """The measured values of a log; ``words`` are the texts of its damage and its findings, by key and value."""

    measures: Measures
    log: Readings
    first_ns: int
    words: Mapping[tuple[str, Any], str]

    def new_topics(self, contract: Contract) -> list[str]:
        """The topics that a contract does not have."""
        return sorted(set(self.measures.topics) - set(contract.topics))


@dataclass(frozen=True)
class Broken:
    """A limit that a log breaks, with the seconds from the first message and the log time; None without a place."""

    topic: str
    key: str
    expected: str
    found: str
    at_s: float | None = None
    at_ns: int | None = None

    def __str__(self) -> str:
        at = "" if self.at_s is None else f" at {self.at_s:.3f} s ({self.at_ns} ns)"
        return f"{self.topic or 'log'}: {self.key}: expected {self.expected}, found {self.found}{at}"


def record(paths: Sequence[Path], overrides: Mapping[str, str], cfg: ReplayConfig) -> MeasuredLog:
    """Measure a log of one or several files.

    Raises:
        LogError: a file cannot be opened, or is not a log. A damaged log raises no error.
    """
    measures = Measures()
    files = [examine(file, overrides, cfg, measures) for file in log.received(paths)]
    first_ns = min((facts.first_ns for facts in files if facts.first_ns is not None), default=0)
    measures.finish(first_ns, max((facts.last_ns or 0 for facts in files), default=0))
    damages = [damage.words for facts in files for damage in facts.file.damages]
    findings = {finding.code: finding.text for facts in files for finding in facts.replay.findings}
    readings: dict[str, list[Any]] = {
        "duration_s": [sum(facts.span_s for facts in files)],
        "segments": [max(facts.replay.segments for facts in files)],
        "late": [measures.late / max(measures.inputs, 1)],
        "damages": [len(damages)],
        "findings": list(findings),
    }
    words: dict[tuple[str, Any], str] = {("findings", code): text for code, text in findings.items()}
    words |= {("damages", len(damages)): damages[0]} if damages else {}
    return MeasuredLog(measures, {key: dict.fromkeys(values) for key, values in readings.items()}, first_ns, words)


def learned(recordings: Sequence[MeasuredLog]) -> Contract:
    """The contract that all logs keep, with a margin. A topic that only some logs have is optional."""
    topics = {}
    for topic in sorted({topic for one in recordings for topic in one.measures.topics}):
        found = [one.measures.topics[topic] for one in recordings if topic in one.measures.topics]
        limits, fewest = _limits(KEYS, [one.readings for one in found]), min(one.messages for one in found)
        unlimited: tuple[str, ...] = _OF_TIMES if fewest < _FEWEST else ()
        if max(max(one.readings["repeats"]) for one in found) >= fewest / 2:
            unlimited += ("repeats",)
        if min(min(one.readings["message_bytes"]) for one in found) < _LEAST_BYTES:
            unlimited += ("repeats", "message_bytes")
        optional = {"optional": True} if len(found) < len(recordings) else {}
        topics[topic] = optional | {key: limit for key, limit in limits.items() if key not in unlimited}
    return Contract(log=_limits(KEYS_OF_LOG, [one.log for one in recordings]), topics=topics)


def _limits(keys: Mapping[str, Margin | None], logs: Sequence[Readings]) -> dict[str, Limit]:
    """The limits of the keys that all logs have a value of."""
    period_s = max((1 / min(one["rate_hz"]) for one in logs if "rate_hz" in one), default=0.0)
    jitter_s = max((max(one["jitter_s"]) for one in logs if "jitter_s" in one), default=0.0)
    limits: dict[str, Limit] = {}
    for key, margin in keys.items():
        if any(key not in one for one in logs):
            continue
        values = sorted({value for one in logs for value in one[key]})
        if margin is None:
            limits[key] = tuple(values)
        else:
            is_event = key in _OF_TIMES and jitter_s > _IRREGULAR * period_s
            used = Margin(periods=4.0, factor=4.0, side=margin.side) if is_event else margin
            low = min(max(one[key]) for one in logs) if margin.side == "most" else values[0]
            limits[key] = used.around(low, values[-1], period_s)
    return limits


def broken(recording: MeasuredLog, contract: Contract) -> tuple[Broken, ...]:
    """The limits that a log breaks: those of the whole log, then those of each topic."""
    found = list(_broken("", contract.log, recording.log, recording))
    for topic, limits in contract.topics.items():
        measured = recording.measures.topics.get(topic)
        if measured is None:
            if not limits.get("optional"):
                expected = _words(limits.get("types", ("messages",)))
                found.append(Broken(topic, "topic", expected, _instead(limits, recording, contract)))
            continue
        wrong = list(_broken(topic, limits, measured.readings, recording))
        if any(one.key == "types" for one in wrong):  # the rest follows from it
            wrong = [one for one in wrong if one.key == "types"]
        elif not measured.decoded and not set(limits) <= set(_OF_ANY_TOPIC):
            found_instead = "none; see roadperc-info without --contract"
            wrong = [one for one in wrong if one.key in _OF_ANY_TOPIC]
            wrong.append(Broken(topic, "role", "messages that a replay reads", found_instead))
        found += wrong
    if any(one.topic in recording.measures.references and one.key in _OF_FRAMES for one in found):
        found = [one for one in found if one.key != "offset_s"]  # the frames are wrong, not the other sensors
    return tuple(found)


def _instead(limits: Mapping[str, Limit], recording: MeasuredLog, contract: Contract) -> str:
    """No message, and the topics of the same type that the contract does not have."""
    topics, types = recording.measures.topics, limits.get("types")
    new = [topic for topic in recording.new_topics(contract) if tuple(topics[topic].readings["types"]) == types]
    return "no message" + (f"; is it {listed(new, 3)} now?" if new else "")


def _broken(topic: str, limits: Mapping[str, Limit], readings: Readings, recording: MeasuredLog) -> Iterator[Broken]:
    if unknown := [key for key in limits if key not in (*readings, *_MAY_BE_UNKNOWN, "optional")]:
        yield Broken(topic, ", ".join(unknown), _words(limits[unknown[0]]) if len(unknown) == 1 else "values", "none")
    for key, limit in limits.items():
        for value, at_ns in readings.get(key, {}).items():
            if not _keeps(value, limit):
                at_s = None if at_ns is None else ns_to_seconds(at_ns - recording.first_ns)
                why = recording.words.get((key, value), "")
                found = (value if isinstance(value, str) else f"{value:.6g}") + f" ({why})" * bool(why)
                yield Broken(topic, key, _words(limit), found, at_s, at_ns)


def _keeps(value: Any, limit: Limit) -> bool:
    if isinstance(value, str):
        return isinstance(limit, tuple) and value in limit
    low, high = limit if isinstance(limit, tuple) else (-math.inf, limit)
    return bool(low <= value <= high)


def _words(limit: Limit) -> str:
    match limit:
        case ():
            return "none"
        case (float(low), float(high)):
            return f"{low:.6g} to {high:.6g}" if high < math.inf else f"at least {low:.6g}"
        case tuple():
            return " or ".join(map(str, limit))
    return f"at most {limit:.6g}"


def write_contract(path: Path, contract: Contract, names: Sequence[str], *, force: bool) -> None:
    """Write a contract as TOML, a table for each topic; ``names`` are the logs that it was learned from.

    Raises:
        TargetError: the file exists and ``force`` is false, or it cannot be written.
    """
    what = f"{number(len(names), 'log')}: {listed([shown(name) for name in names])}"
    lines = [_HEAD.format(names=what), "[log]", *map(_line, contract.log.items())]
    for topic, limits in contract.topics.items():
        lines += ["", f"[topics.{_toml(topic)}]", *map(_line, limits.items())]
    write_whole(path, "\n".join(lines) + "\n", force=force)


def _line(item: tuple[str, Limit]) -> str:
    key, limit = item
    return f"{key} = [{', '.join(map(_toml, limit))}]" if isinstance(limit, tuple) else f"{key} = {_toml(limit)}"


def _toml(value: float | str) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else f"{value:.15g}"


def read_contract(path: Path) -> Contract:
    """The contract of a file.

    Raises:
        ConfigError: the file cannot be read, limits nothing, or a key or value is invalid; the message names it.
    """
    try:
        return Contract.model_validate(read_toml(path))
    except ValidationError as error:
        first = error.errors()[0]
        why = complaint(first)
        if first["type"].startswith("bool"):  # the first kind of a limit
            why = f"expected a number, two numbers, a list of names, or true or false, found {in_brief(first['input'])}"
        raise ConfigError(f"{path}: {': '.join(filter(None, (key_of(first['loc']), why)))}") from error
