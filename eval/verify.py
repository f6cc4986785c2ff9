"""Verifies a replay: the same log again, in other threads and in two parts, must give the same messages and tables.

The second part continues the first one, so a stage of the user's own gets its saved ``State`` in a new object. The cut
is where half of the frames are complete: a frame is complete when no message within ``sync.max_wait_s`` can change it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from heapq import merge
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream import log
from roadperc_stream.chain.own_stage import own_stages
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import RegressionError
from roadperc_stream.input import ReplaySource
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.log import Message
from roadperc_stream.loop import replay
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import Callbacks
from roadperc_stream.resume.opening import ReplayOptions
from roadperc_stream.schemas.topics import METRICS_TOPIC, RESULT_PREFIX, STAGES
from roadperc_stream.system.files import scratch_folder
from roadperc_stream.system.progress import Progress, no_progress
from roadperc_stream.system.text import number
from roadperc_stream.system.time import TimeRange, ns_to_seconds, seconds_to_ns

from .compare.fields import NOT_COMPARED, Difference, column_agreement
from .compare.messages import aligned, frame_agreements
from .compare.pairing import NEW
from .compare.summary import both_values
from .options import Rules

_RULES: Final = Rules(ignored=("metrics.log_id",))
"""The ``log_id`` of a part is another one."""
_KEY: Final = ("frame", "stamp_ns", "nth of frame")
_ROW: Final = "row"
_MADE_BY: Final = {
    "stereo": ("stereo", "debug/disparity"),
    "surface": ("surface", "drivable", "camera_"),
    "odometry": ("odometry", "trajectory", "tf", "debug/matches", "step_", "turn_", "odom_"),
    "lanes": ("lane", "debug/lanes"),
    "objects": ("object", "debug/template", "detections", "nearest_", "time_to_impact", "path_", "cut_ins", "filter_"),
    "occupancy": ("occupancy",),
}
"""Beginnings of the topics and columns of each stage."""
_DIGITS: Final = (6, 17)


@dataclass(frozen=True)
class _Parts:
    """A replay in parts: logs, the log time of the cut, and the first frame that the second part computes."""

    paths: tuple[Path, ...]
    cut_ns: int = 0
    first_frame: int = 0

    def messages(self) -> Iterator[Message]:
        """The messages of the whole log: of repeated frames the later version, of the input each one once."""
        first, *second = map(_messages, self.paths)
        if not second:
            return first
        cut_ns, frame = self.cut_ns, self.first_frame
        earlier = (m for m in first if (m.sequence < frame if is_result(m.channel) else m.log_time_ns < cut_ns))
        later = (m for m in second[0] if is_result(m.channel) or m.log_time_ns >= cut_ns)
        return merge(earlier, later, key=lambda message: message.log_time_ns)

    def table(self, name: str) -> pl.DataFrame:
        """The rows of the whole log in the tables of this name."""
        first, *second = (pl.read_parquet(sidecar_path(path, name), glob=False) for path in self.paths)
        return pl.concat([first.filter(pl.col("frame") < self.first_frame), *second]) if second else first


@dataclass(frozen=True)
class _Replay:
    """The replay to verify; ``target`` is complete."""

    source: ReplaySource
    target: ReplayTarget
    cfg: ReplayConfig
    options: ReplayOptions
    progress: Progress

    @property
    def other_threads(self) -> int:
        return 1 if self.options.threads > 1 else 2

    def again(self, path: Path, part: TimeRange, *, threads: int, continued: Path | None = None) -> int:
        """Replay a part of the log with new objects of the user's own stages, and return its number of frames."""
        earlier = continued or self.options.continued
        warm_up_s = 0.0 if continued else self.options.warm_up_s
        options = ReplayOptions(earlier, warm_up_s, threads=threads, own=own_stages(self.cfg)[1])
        source, target = replace(self.source, time_range=part), ReplayTarget(path, False, self.target.on_request)
        return replay(source, target, self.cfg, options, Callbacks(self.progress)).frames

    def in_parts(self, folder: Path) -> _Parts:
        """The log in two parts; in one part if it is too short to cut."""
        asked, frames = self.source.time_range, _frames(self.target.path)
        found, times_ns = self.source.read(self.cfg.limits), [message.log_time_ns for message in frames]
        cut_ns = (times_ns[0] + times_ns[-1] + seconds_to_ns(self.cfg.sync.max_wait_s)) // 2
        first, second = folder / "first.mcap", folder / "second.mcap"
        if cut_ns > times_ns[-1]:
            self.again(first, asked, threads=self.other_threads)
            return _Parts((first,))
        cut_s = ns_to_seconds(cut_ns - (found.first_ns or found.summary.first_ns or 0))
        done = self.again(first, TimeRange(asked.start_s, cut_s), threads=self.other_threads)
        most = None if asked.frames is None else len(frames) - done
        rest = TimeRange(cut_s, asked.end_s, most)
        self.again(second, rest, threads=self.other_threads, continued=first)
        return _Parts((first, second), cut_ns, _frames(second)[0].sequence)


def verify(
    source: ReplaySource,
    target: ReplayTarget,
    cfg: ReplayConfig,
    options: ReplayOptions,
    progress: Progress = no_progress,
) -> list[str]:
    """Replay a log again with other threads and another cut, and compare all messages and both tables.

    Args:
        source: the log of the replay.
        target: its complete output.
        cfg: its configuration.
        options: its options.
        progress: called with frames done and expected.

    Returns:
        Lines for the user: what is identical.

    Raises:
        RegressionError: a message or a row differs; the text names the first one, and the stage that made it.
        RoadpercError: the log cannot be replayed again.
    """
    first = _Replay(source, target, cfg, options, progress)
    with scratch_folder(target.path) as folder:
        parts = first.in_parts(folder)
        again = (message for message in parts.messages() if not target.results_only or is_result(message.channel))
        count, difference = _compared(target.path, _messages(target.path), parts.paths[-1], again)
        if difference is not None:
            raise RegressionError(_text(first, difference, _cause(first, parts, difference, folder)))
        for name in ("metrics", "objects"):
            if (difference := _different_row(target, parts, name)) is not None:
                raise RegressionError(_text(first, difference, f"in the table of {name}"))
    is_cut = parts.first_frame > _frames(target.path)[0].sequence
    short = f"note: too short to cut (sync.max_wait_s is {cfg.sync.max_wait_s:g} s), so replayed again in one part"
    return [*([] if is_cut else [short]), f"identical: {number(count, 'message')}, 2 tables"]


def _frames(path: Path) -> list[Message]:
    """The row of each frame of a result, as messages; ``sequence`` is the number of the frame."""
    return list(log.read(log.summarise(path), topics=(METRICS_TOPIC,)))


def _messages(path: Path) -> Iterator[Message]:
    return log.read(log.summarise(path))


def _compared(
    path: Path, messages: Iterator[Message], other: Path, again: Iterator[Message]
) -> tuple[int, Difference | None]:
    """The number of compared messages, and the first one that differs."""
    count = 0
    for ours, theirs in aligned(messages, again):
        found = frame_agreements(ours, theirs, (path, other), "", _RULES)
        if differing := [agreement.first for agreement in found.values() if agreement.first]:
            return count, min(differing, key=lambda one: (one.frame, _order(one.place)))
        count += len(ours)
    return count, None


def _different_row(target: ReplayTarget, parts: _Parts, name: str) -> Difference | None:
    """The first row of a table that differs, times left out.

    Rows before the cut lack what only later frames find by hindsight.
    """
    whole = pl.read_parquet(sidecar_path(target.path, name), glob=False)
    nth = pl.int_range(pl.len()).over("frame").alias(_KEY[2])
    ours, theirs = (table.with_columns(nth, pl.lit("present").alias(_ROW)) for table in (whole, parts.table(name)))
    columns = [_ROW, *(column for column in whole.columns if column not in (*_KEY, *NOT_COMPARED, "log_id"))]
    renamed = theirs.rename({column: column + NEW for column in theirs.columns if column not in _KEY})
    joined = ours.join(renamed, on=_KEY, how="full", coalesce=True).sort(_KEY)
    is_early = pl.col("frame") < parts.first_frame
    later = [column for column in columns if "hindsight" in column]
    joined = joined.with_columns(
        pl.when(is_early).then(pl.coalesce(column + NEW, column)).otherwise(column + NEW).alias(column + NEW)
        for column in later
    )
    found = [first for column in columns if (first := column_agreement(joined, column, "").first)]
    return min(found, key=lambda one: one.frame, default=None)


def _cause(first: _Replay, parts: _Parts, difference: Difference, folder: Path) -> str:
    """Why a stage differs: a replay like the first one, up to the frame, tells threads and cut from chance."""
    numbers, path = [message.sequence for message in _frames(first.target.path)], folder / "third.mcap"
    asked = first.source.time_range
    if difference.frame not in numbers:
        return ""
    part = TimeRange(asked.start_s, asked.end_s, numbers.index(difference.frame) + 1)
    first.again(path, part, threads=first.options.threads)
    ours, theirs = (_up_to(difference.frame, _messages(one)) for one in (first.target.path, path))
    if _compared(first.target.path, ours, path, theirs)[1] is not None:
        return "not deterministic: the same replay again differs too (time, random numbers, or global values?)"
    if parts.first_frame and difference.frame >= parts.first_frame:
        return f"depends on the cut before frame {parts.first_frame}: it keeps values of earlier frames outside State"
    return f"depends on the threads: {first.options.threads} and {first.other_threads} differ"


def _up_to(frame: int, messages: Iterator[Message]) -> Iterator[Message]:
    """The results of the frames up to this one."""
    return (message for message in messages if is_result(message.channel) and message.sequence <= frame)


def _stage(place: str) -> str:
    """The stage that makes a message or a column; empty if it is of all stages, such as ``reasons``."""
    name = place.removeprefix("metrics.")
    return next((stage for stage, beginnings in _MADE_BY.items() if name.startswith(beginnings)), "")


def _order(place: str) -> tuple[int, bool]:
    """Sorts differences of one frame: the stages in the order of execution, messages before the row."""
    stage = _stage(place)
    return STAGES.index(stage) if stage else len(STAGES), place.startswith("metrics.")


def _text(first: _Replay, difference: Difference, cause: str) -> str:
    topic, _, field = difference.place.partition(".")
    is_copy, stage = topic.startswith("/"), _stage(difference.place)
    named = topic if is_copy or not field else f"{RESULT_PREFIX}{topic}"
    own = {name: f"{name} ({item.name})" for name, item in first.options.own.items()}
    made_by = own.get(stage) or "; own stages: ".join(filter(None, (stage, ", ".join(own.values()))))
    stamps_ns = dict(pl.read_parquet(first.target.metrics, columns=["frame", "stamp_ns"], glob=False).iter_rows())
    at_ns = difference.stamp_ns if is_copy else stamps_ns.get(difference.frame, difference.stamp_ns)
    at = f"at {at_ns} ns" if is_copy else f"in frame {difference.frame} (stamp {at_ns} ns)"
    values = both_values(difference.base, difference.new, _DIGITS)
    differs = " ".join(filter(None, ("differs:", named, field, values, at)))
    return "; ".join(filter(None, (differs, made_by and f"made by {made_by}", cause)))
