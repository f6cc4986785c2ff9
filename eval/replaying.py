"""Replays a log with settings: those of the user, or those that the table of a run records.

``replay_with`` serves sweep, bisect, and the frames and excerpts of runs whose result log was not kept.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import gettempdir
from typing import Any, Final

import polars as pl

from roadperc_stream import log
from roadperc_stream.batch.addresses import is_address
from roadperc_stream.batch.location import Location
from roadperc_stream.chain.own_stage import own_stages
from roadperc_stream.config import ReplayConfig, implementations, load_config
from roadperc_stream.errors import ConfigError, LogError, TableError
from roadperc_stream.input import ReplaySource
from roadperc_stream.loop import replay
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import Callbacks, ReplaySummary
from roadperc_stream.resume.opening import ReplayOptions
from roadperc_stream.schemas.columns import EXTRA_COLUMNS
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.schemas.topics import ON_REQUEST, Request
from roadperc_stream.system.files import not_a_log, scratch_folder
from roadperc_stream.system.progress import Progress, no_progress
from roadperc_stream.system.text import listed, number
from roadperc_stream.system.threads import usable_cores
from roadperc_stream.system.time import TimeRange, ns_to_seconds
from roadperc_stream.view.pictures import picture_channels

from .runs import Run, collect, find_runs
from .scan import rows_of

_FAR_S: Final = 60.0
"""A frame later than this is replayed from a warm-up before it, not from the start."""
_WARM_UP_S: Final = 20.0
BEFORE_S: Final = 5.0
"""Shown before a far frame."""
AFTER_S: Final = 2.0
"""Replayed after the frame, because messages may be logged this long after their stamps."""
_OF_THE_REPLAY: Final = ("log_id", "config", "frame", "segment", "reasons", "missing", "odom_", *EXTRA_COLUMNS)
"""Beginnings of columns that are not results, or depend on the part of the log."""
_SAME: Final = 1e-6
"""Relative difference of numbers below which they are equal, as on another processor."""


def replay_with(
    source: ReplaySource,
    target: ReplayTarget,
    cfg: ReplayConfig,
    *,
    warm_up_s: float = 0.0,
    threads: int | None = None,
    progress: Progress = no_progress,
) -> ReplaySummary:
    """Replay a log, or the part of it that ``source`` names, with settings; ``threads`` is by default one a core.

    Raises:
        RoadpercError: the log cannot be replayed, or the target cannot be written.
    """
    cfg, own = own_stages(cfg)
    options = ReplayOptions(warm_up_s=warm_up_s, threads=threads or usable_cores(), own=own)
    return replay(source, target, cfg, options, Callbacks(progress))


def require_log(path: Path) -> None:
    """Check that a path is a file, before anything is replayed.

    Raises:
        LogError: it is a folder, or does not exist.
    """
    if not path.is_file():
        raise LogError(not_a_log(path) if path.is_dir() else f"{path}: no such file")


@dataclass(frozen=True)
class FrameToShow:
    """A log to show, and notes on it. ``number`` is that of the frame in the log; an excerpt counts from its start."""

    log: Path
    number: int | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Part:
    """The part of a log to replay: up to a frame, or around the first and the last stamp ``span_ns`` of an excerpt.

    ``target`` keeps the replay; None writes it into a temporary folder, with the pictures ``on_request``.
    """

    frame: int
    span_ns: tuple[int, int] | None = None
    target: ReplayTarget | None = None
    on_request: Collection[Request] = ()


def shown(
    run: Run | Path,
    frame: int | None,
    topics: Mapping[str, str],
    picture: str,
    changed: Sequence[str],
    files: ExitStack,
    bar: Progress,
) -> FrameToShow:
    """The log of a run, or a replay of its input up to a frame.

    Args:
        run: a run, or a log.
        frame: number of the frame in the table.
        topics: topic by role, as in the recorded replay.
        picture: topic of the debug picture to show; a log without it is replayed. Empty for none.
        changed: settings ``KEY=VALUE``; a stage of the user's own must be among them to run.
        files: removes a replayed log when it closes.
        bar: called with frames done and expected.

    Raises:
        TableError: the table has no such frame, or no configuration.
        LogError: the input is missing or is not the log of the table.
        ConfigError: a stage of the user's own is not repeated.
    """
    kept = run if isinstance(run, Path) else kept_log(run)
    requests = {request for topic, request in ON_REQUEST.items() if topic == picture and request == "debug"}
    if kept and not (requests and picture not in picture_channels(log.summarise(kept))):
        return FrameToShow(kept, frame)
    run = find_runs([str(run)])[0] if isinstance(run, Path) else run
    if frame is None:
        raise TableError(f"{run.path}: its result log was not kept; pass --frame N or --worst COLUMN")
    folder = files.enter_context(scratch_folder(Path(gettempdir(), "roadperc-view")))
    return replayed(run, Part(frame, on_request=requests), topics, changed, folder, bar)


def kept_log(run: Run) -> Path | None:
    """The result log of a run; None if it was not kept."""
    path = Path(run.log) if run.dataset else run.beside(".mcap")
    return path if path.is_file() else None


def recorded_config(run: Run, changed: Sequence[str], folder: Path) -> ReplayConfig:
    """The configuration that a table records, with ``changed`` settings; ``folder`` is temporary."""
    config = folder / CONFIG_ATTACHMENT
    config.write_text(run.config, "utf-8", errors="surrogateescape")
    return load_config(config, changed)


def replayed(
    run: Run, part: Part, topics: Mapping[str, str], changed: Sequence[str], folder: Path, progress: Progress
) -> FrameToShow:
    """A replay of a part of a run's input; the arguments and errors are those of ``shown``, ``folder`` is temporary."""
    if not run.source or not run.config:
        raise TableError(f"{run.path}: does not record the input and the configuration; replay the log")
    rows = collect(rows_of(run), run.source_name)
    found = rows.filter(pl.col("frame") == part.frame)
    if found.is_empty():
        raise TableError(f"{run.path}: no frame {part.frame}; the table has {number(rows.height, 'frame')}")
    row, cfg = found.row(0, named=True), recorded_config(run, changed, folder)
    named = [f"{stage}.implementation={name}" for stage, name in implementations(cfg)]
    if missing := [f"--set {setting}" for setting in named if setting not in changed]:
        raise ConfigError(f"{run.path}: used a stage of your own; to run its code, pass {' '.join(missing)}")
    path, (overrides, recorded) = _input(run, folder), _options(run)
    time_range, warm_up_s = _time_range(row, part, recorded, log.summarise(path).first_ns or 0)
    source = ReplaySource(path, {**overrides, **topics}, time_range, recover=True)
    target = part.target or ReplayTarget(folder / "out.mcap", on_request=part.on_request)
    replay_with(source, target, cfg, warm_up_s=warm_up_s, progress=progress)
    again = pl.read_parquet(target.metrics, glob=False).filter(pl.col("stamp_ns") == row["stamp_ns"])
    if again.is_empty():
        raise LogError(f"{run.source}: no frame with stamp {row['stamp_ns']} ns; it is not the whole log of the run")
    is_far = warm_up_s > 0 and part.target is None
    far = (f"replayed from {_WARM_UP_S + BEFORE_S:g} s before the frame; the trajectory starts there",) * is_far
    return FrameToShow(target.path, again["frame"][0], (*far, *_differing(row, again.row(0, named=True))))


def _time_range(row: Mapping[str, Any], part: Part, recorded: TimeRange, begin_ns: int) -> tuple[TimeRange, float]:
    """The part of the range to replay, and the seconds of warm-up before it; the log begins at ``begin_ns``."""
    first_s, last_s = (ns_to_seconds(ns - begin_ns) for ns in part.span_ns or (row["stamp_ns"],) * 2)
    start_s, end_s = recorded.start_s or 0.0, min(last_s + AFTER_S, recorded.end_s or math.inf)
    if part.span_ns is None and first_s - start_s <= _FAR_S:
        return TimeRange(recorded.start_s, end_s, row["frame"] + 1), 0.0
    return TimeRange(max(first_s - BEFORE_S, start_s), end_s), _WARM_UP_S


def _input(run: Run, folder: Path) -> Path:
    if is_address(run.source):
        copy = folder / "in.mcap"
        Location(run.source).fetch(copy)
        return copy
    if not Path(run.source).exists():
        if kept := kept_log(run):  # it has copies of the input's messages
            return kept
        raise LogError(f"{run.source}: no such file: {run.name} has no result log; put the input log there")
    return Path(run.source)


def _options(run: Run) -> tuple[dict[str, str], TimeRange]:
    """The topics by role and the time range of a batch, from the text that ``BatchConfiguration.options`` writes."""
    words = run.options.split()
    pairs = list(zip(words[::2], words[1::2], strict=False))
    numbers = dict(pairs)
    try:
        start_s, end_s = (float(numbers[name]) if name in numbers else None for name in ("--start", "--end"))
        return parse_topic_options(value for name, value in pairs if name == "--topic"), TimeRange(start_s, end_s)
    except (ValueError, ConfigError) as error:
        raise TableError(f"{run.path}: options {run.options!r}: {error}; replay the log again") from error


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
