"""The log that shows a frame of a run; one that was not kept is replayed up to the frame, as it was recorded."""

import argparse
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import polars as pl

from roadperc_stream import log
from roadperc_stream.batch.storage.addresses import is_address
from roadperc_stream.batch.storage.location import Location
from roadperc_stream.chain.own_stage import own_stages
from roadperc_stream.config import ReplayConfig, implementations, load_config
from roadperc_stream.errors import ConfigError, LogError, TableError
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

from .quantities import listed
from .runs import Run, collect
from .scan import rows_of

_FAR_S: Final = 60.0
"""A frame later than this is replayed from a warm-up before it, not from the start."""
_WARM_UP_S: Final = 20.0
_BEFORE_S: Final = 5.0
"""Shown before a far frame."""
_AFTER_S: Final = 2.0
"""Replayed after the frame, because messages may be logged this long after their stamps."""
_OF_THE_REPLAY: Final = ("log_id", "config", "frame", "segment", "reasons", "missing", "odom_", *TIME_COLUMNS)
"""Beginnings of columns that are not results, or depend on the part of the log."""
_SAME: Final = 1e-6
"""Relative difference of numbers below which they are equal, as on another processor."""


@dataclass(frozen=True)
class FrameToShow:
    """A log to show, and notes on it. ``number`` is that of the frame in the log; an excerpt counts from its start."""

    log: Path
    number: int | None
    notes: tuple[str, ...] = ()


def shown(
    run: Run | Path, frame: int | None, topics: Sequence[str], changed: Sequence[str], files: ExitStack, bar: Progress
) -> FrameToShow:
    """The log of a run, or a replay of its input up to a frame.

    Args:
        run: a run, or a log.
        frame: number of the frame in the table.
        topics: ``ROLE=/TOPIC``, as in the recorded replay.
        changed: settings ``KEY=VALUE``; a stage of the user's own must be among them to run.
        files: removes a replayed log when it closes.
        bar: called with frames done and expected.

    Raises:
        TableError: the table has no such frame, or no configuration.
        LogError: the input is missing or is not the log of the table.
        ConfigError: a stage of the user's own is not repeated.
    """
    kept = run if isinstance(run, Path) else Path(run.log) if run.dataset else run.beside(".mcap")
    if isinstance(run, Path) or kept.is_file():
        return FrameToShow(kept, frame)
    if frame is None:
        raise TableError(f"{run.path}: its result log was not kept; pass --frame N or --worst COLUMN")
    if not run.source or not run.config:
        raise TableError(f"{run.path}: does not record the input and the configuration; replay the log")
    rows = collect(rows_of(run), run.source_name)
    found = rows.filter(pl.col("frame") == frame)
    if found.is_empty():
        raise TableError(f"{run.path}: no frame {frame}; the table has {number(rows.height, 'frame')}")
    folder = Path(files.enter_context(TemporaryDirectory(prefix="roadperc-view-")))
    config = folder / CONFIG_ATTACHMENT
    config.write_text(run.config, "utf-8", errors="surrogateescape")
    cfg = load_config(config, changed)
    named = [f"{stage}.implementation={name}" for stage, name in implementations(cfg)]
    if missing := [f"--set {setting}" for setting in named if setting not in changed]:
        raise ConfigError(f"{run.path}: used a stage of your own; to run its code, pass {' '.join(missing)}")
    return _replayed(run, found.row(0, named=True), topics, cfg, folder, bar)


def _replayed(
    run: Run, row: Mapping[str, Any], topics: Sequence[str], cfg: ReplayConfig, folder: Path, progress: Progress
) -> FrameToShow:
    cfg, own = own_stages(cfg)
    source, options = _input(run, folder), _options(run.options)
    at_s = ns_to_seconds(row["stamp_ns"] - (log.summarise(source).first_ns or 0))
    is_far = at_s - (options.start or 0.0) > _FAR_S
    end_s = min(at_s + _AFTER_S, options.end or math.inf)
    part = TimeRange(at_s - _BEFORE_S, end_s) if is_far else TimeRange(options.start, end_s, row["frame"] + 1)
    target = ReplayTarget(folder / "out.mcap")
    replay(
        ReplaySource(source, parse_topic_options([*options.topic, *topics]), part, recover=True),
        target,
        cfg,
        ReplayOptions(warm_up_s=_WARM_UP_S if is_far else 0.0, threads=usable_cores(), own=own),
        Callbacks(progress),
    )
    again = pl.read_parquet(target.metrics).filter(pl.col("stamp_ns") == row["stamp_ns"])
    if again.is_empty():
        raise LogError(f"{run.source}: no frame with stamp {row['stamp_ns']} ns; it is not the whole log of the run")
    far = (f"replayed from {_WARM_UP_S + _BEFORE_S:g} s before the frame; the trajectory starts there",) * is_far
    return FrameToShow(target.path, again["frame"][0], (*far, *_differing(row, again.row(0, named=True))))


def _input(run: Run, folder: Path) -> Path:
    if is_address(run.source):
        copy = folder / "in.mcap"
        Location(run.source).fetch(copy)
        return copy
    if not Path(run.source).exists():
        raise LogError(f"{run.source}: no such file: {run.name} has no result log; put the input log there")
    return Path(run.source)


def _options(text: str) -> argparse.Namespace:
    """The options of a batch, as ``BatchConfiguration.options`` writes them."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--topic", action="append", default=[])
    for name in ("--start", "--end", "--frames"):
        parser.add_argument(name, type=float)
    return parser.parse_args(shlex.split(text))


def _differing(row: Mapping[str, Any], again: Mapping[str, Any]) -> Iterator[str]:
    """A note on the values that differ from the recorded run."""
    compared = [name for name in row if name in again and not name.startswith(_OF_THE_REPLAY)]
    differing = [name for name in compared if not _same(row[name], again[name])]
    if differing:
        values = listed([f"{name} {again[name]} (recorded {row[name]})" for name in differing], 3)
        yield f"{number(len(differing), 'value')} of the frame differ: {values}"


def _same(one: Any, other: Any) -> bool:
    numbers = isinstance(one, float) and isinstance(other, float)
    return bool(one == other) or (numbers and math.isclose(one, other, rel_tol=_SAME, abs_tol=_SAME))
