"""Replays the input of a run up to a frame, with the recorded configuration, to show a frame whose log was not kept."""

import argparse
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import polars as pl

from roadperc_stream import __version__, log
from roadperc_stream.batch.storage.addresses import is_address
from roadperc_stream.batch.storage.location import Location
from roadperc_stream.config import load_config
from roadperc_stream.errors import LogError, TableError
from roadperc_stream.input import ReplaySource
from roadperc_stream.loop import replay
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import Callbacks
from roadperc_stream.resume.opening import ReplayOptions
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.system.progress import Progress
from roadperc_stream.system.text import number
from roadperc_stream.system.threads import usable_cores
from roadperc_stream.system.time import TimeRange, ns_to_seconds

from .runs import Run, collect
from .scan import rows_of

_FAR_S: Final = 60.0
"""A frame later than this is replayed from a warm-up before it, not from the start."""
_WARM_UP_S: Final = 20.0
_BEFORE_S: Final = 5.0
"""Shown before a far frame."""
_BEGIN_S: Final = 0.5
"""A table that begins this close to the log's start is of the whole log, and its rows can be counted."""
_AFTER_S: Final = 2.0
"""Replayed after the frame, because messages may be logged this long after their stamps."""
_OF_THE_REPLAY: Final = frozenset({"log_id", "config", "frame", "segment", "reasons", "missing", *TIME_COLUMNS})
"""Columns that are not results, or depend on the part of the log."""
_FROM_THE_START: Final = "odom_"
"""Prefix of columns that count from the replay's first frame."""
_SAME: Final = 1e-6
"""Relative difference of numbers below which they are equal, as on another processor."""
_MOST_LISTED: Final = 3


@dataclass(frozen=True)
class Recorded:
    """A run as its table or its dataset records it.

    ``log`` is the result, None if it was not kept; ``source`` the input's path or address, ``config`` settings as TOML,
    ``options`` the options of its batch, as on the command line. ``run`` is None without a table.
    """

    name: str
    log: Path | None
    run: Run | None = None
    source: str = ""
    version: str = ""
    config: str = ""
    options: str = ""
    recover: bool = False


@dataclass(frozen=True)
class ReplayedFrame:
    """A replayed log, the number of the frame in it, and notes on values that differ."""

    log: Path
    number: int
    notes: tuple[str, ...]


def replay_up_to(
    recorded: Recorded, frame: int, folder: Path, topics: Sequence[str], progress: Progress
) -> ReplayedFrame:
    """Replay the input of a run up to a frame of its table.

    Args:
        recorded: the run.
        frame: number of the frame in the table.
        folder: for the result.
        topics: ``ROLE=/TOPIC``, as in the recorded replay.
        progress: called with frames done and expected.

    Raises:
        TableError: the table has no such frame, or no configuration.
        LogError: the input is missing or is not the log of the table.
    """
    run, row, before_s, position = _row(recorded, frame)
    if not recorded.source or not (recorded.config or run.config_digest):
        raise TableError(f"{recorded.name}: its table does not record the input and the configuration; replay the log")
    source, options = _input(recorded, folder), _options(recorded.options)
    at_s = ns_to_seconds(row["stamp_ns"] - (log.summarise(source).first_ns or 0))
    begin_s = options.start or 0.0
    is_far = at_s - begin_s > _FAR_S
    start_s = at_s - _BEFORE_S if is_far else options.start
    end_s = at_s + _AFTER_S if options.end is None else min(at_s + _AFTER_S, options.end)
    is_from_start = abs(at_s - begin_s - before_s) < _BEGIN_S and not is_far
    frames = position if is_from_start else None
    written = folder / CONFIG_ATTACHMENT
    written.write_text(recorded.config, "utf-8", errors="surrogateescape")
    target = ReplayTarget(folder / "out.mcap")
    replay(
        ReplaySource(
            (source,),
            parse_topic_options([*options.topic, *topics]),
            TimeRange(start_s, end_s, frames),
            recorded.recover,
        ),
        target,
        load_config(written),
        ReplayOptions(warm_up_s=min(_WARM_UP_S, start_s - begin_s) if is_far else 0.0, threads=usable_cores()),
        Callbacks(progress),
    )
    again = pl.read_parquet(target.metrics).filter(pl.col("stamp_ns") == row["stamp_ns"])
    if again.is_empty():
        raise LogError(
            f"{recorded.source}: no frame with stamp {row['stamp_ns']} ns; it is not the whole log of the run"
        )
    return ReplayedFrame(target.path, again["frame"][0], tuple(_notes(recorded, row, again.row(0, named=True), is_far)))


def _row(recorded: Recorded, frame: int) -> tuple[Run, dict[str, Any], float, int]:
    """The run, the row, seconds from the first row to it, and the number of rows up to it."""
    run = recorded.run
    if run is None:
        raise TableError(f"{recorded.name}: has no metrics table")
    rows = collect(rows_of(run), run.source_name)
    found = rows.filter(pl.col("frame") == frame)
    if found.is_empty():
        frames = rows["frame"].to_list()
        known = f"expected {min(frames)} to {max(frames)}" if frames else "the table is empty"
        raise TableError(f"{run.path}: no frame {frame}; {known}")
    row = found.row(0, named=True)
    earlier = rows.filter(pl.col("frame") <= frame)
    return run, row, ns_to_seconds(row["stamp_ns"] - earlier["stamp_ns"][0]), earlier.height


def _input(recorded: Recorded, folder: Path) -> Path:
    if is_address(recorded.source):
        copy = folder / "in.mcap"
        Location(recorded.source).fetch(copy)
        return copy
    if not Path(recorded.source).exists():
        why = f"the result log of {recorded.name} was not kept, and its input log is missing"
        raise LogError(f"{recorded.source}: no such file: {why}; put the input log there")
    return Path(recorded.source)


def _options(text: str) -> argparse.Namespace:
    """The options of a batch, as ``BatchConfiguration.options`` writes them."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--topic", action="append", default=[])
    for name in ("--start", "--end", "--frames"):
        parser.add_argument(name, type=float)
    return parser.parse_args(shlex.split(text))


def _notes(recorded: Recorded, row: Mapping[str, Any], again: Mapping[str, Any], is_far: bool) -> list[str]:
    """What differs from the recorded run."""
    compared = [name for name in row if name in again and name not in _OF_THE_REPLAY]
    compared = [name for name in compared if not (is_far and name.startswith(_FROM_THE_START))]
    differing = [name for name in compared if not _same(row[name], again[name])]
    notes = []
    if is_far:
        notes.append(f"replayed from {_WARM_UP_S + _BEFORE_S:g} s before the frame; the trajectory starts there")
    if recorded.version != __version__:
        notes.append(f"recorded by version {recorded.version or 'unknown'}, replayed by version {__version__}")
    if differing:
        values = [f"{name} {_text(again[name])} (recorded {_text(row[name])})" for name in differing[:_MOST_LISTED]]
        more = f" and {len(differing) - _MOST_LISTED} more" if len(differing) > _MOST_LISTED else ""
        notes.append(f"{number(len(differing), 'value')} of the frame differ: {', '.join(values)}{more}")
    return notes


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=_SAME, abs_tol=_SAME) or (math.isnan(one) and math.isnan(other))
    return bool(one == other)


def _text(value: Any) -> str:
    return "null" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
