"""A log that is replayed in parts at once: how a worker cuts it, replays one part, and joins their tables."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from roadperc_stream.batch.fetched import FetchedFiles, with_addresses
from roadperc_stream.batch.publishing import of_summary, publish
from roadperc_stream.batch.splitting import SplitPart, parts_of_log
from roadperc_stream.batch.task import BUSY, CUT, CutLog, EndedPart, EndedParts, Outcome, Task
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.progress import Progress
from roadperc_stream.core.text import print_line
from roadperc_stream.input import ReplayInput, ReplaySource
from roadperc_stream.log import is_indexed
from roadperc_stream.loop import NOBODY, Watcher, replay
from roadperc_stream.output.tables import read_table, write_table
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.outputs import ReplaySummary
from roadperc_stream.state.checkpoint import NO_CHECKPOINTS, CheckpointOptions
from roadperc_stream.state.opening import Beginning

if TYPE_CHECKING:
    from roadperc_stream.batch.joining import PartTables

CHECKPOINTS: Final = CheckpointOptions(60.0, resume=True)
"""Seconds of log after which a replay that is killed goes on, rather than from the start."""
_PARTS: Final = ".parts"
"""The folder of a dataset for tables of parts that are yet to be joined."""


def replay_part(
    source: ReplaySource,
    part: SplitPart,
    cfg: ReplayConfig,
    target: Path,
    warm_up_s: float,
    *,
    checkpoints: CheckpointOptions = NO_CHECKPOINTS,
    watcher: Watcher = NOBODY,
) -> ReplaySummary:
    """Replay a part of a log by itself, in one thread; an earlier result is replaced.

    Args:
        source: the whole log.
        part: what of it.
        cfg: the chain's configuration.
        target: the log to write, with its tables beside it; the input's messages are left out.
        warm_up_s: seconds of log before the part, of which nothing is written.
        checkpoints: whether it goes on where it was interrupted.
        watcher: who follows it.

    Raises:
        RoadpercError: as ``loop.replay``.
    """
    beginning = Beginning(warm_up_s=part.warm_up_s(warm_up_s))
    output = ReplayTarget(target, results_only=True, force=True)
    asked = replace(source, time_range=part.time_range)
    return replay(asked, output, cfg, beginning=beginning, checkpoints=checkpoints, watcher=watcher)


def read_part(part: SplitPart, target: Path) -> "PartTables":
    """The tables of a part that was replayed.

    Raises:
        TableError: they cannot be read.
    """
    written = ReplayTarget(target)
    from roadperc_stream.batch.joining import PartTables

    return PartTables(part, read_table(written.metrics), read_table(written.objects))


def cut_log(task: Task, log_in: ReplayInput) -> Outcome | None:
    """The parts to replay a log in; None where it is not to be split, or is one part.

    Raises:
        ConfigError: it cannot be split so.
        LogError: it cannot be read.
    """
    how = task.how
    if how.split_s is None:
        return None
    parts = parts_of_log(log_in, how.cfg, how.split_s, how.time_range)
    cut = CutLog(log_in.log_id, log_in.summary.first_ns or 0, parts, is_indexed(log_in.summary))
    return Outcome(CUT, log_id=log_in.log_id, cut=cut) if parts[1:] else None


def replayed_part(
    task: Task, part: SplitPart, source: ReplaySource, files: FetchedFiles, folder: Path, progress: Progress
) -> Outcome:
    """Replay one of the parts, its tables put where whoever joins them finds them.

    A part that an interrupted batch has finished is not replayed again.

    Raises:
        RoadpercError: it cannot be replayed, or its tables cannot be put there.
    """
    place, made_of = _place(task, part), _made_of(task, part)
    done = task.out.read(f"{place}.json")
    if done is not None and (found := _finished(done, made_of)) is not None:
        return found
    target = ReplayTarget(folder / "out.mcap")
    how = task.how
    summary = replay_part(
        source, part, how.cfg, target.path, how.warm_up_s, checkpoints=CHECKPOINTS, watcher=Watcher(progress)
    )
    files.require_unchanged()
    print_remarks(summary, task, folder)
    for name, table in (("metrics", target.metrics), ("objects", target.objects)):
        task.out.put(table, f"{place}.{name}.parquet")
    outcome = of_summary(summary)
    for_later = replace(outcome, seconds=summary.seconds)
    task.out.write(f"{place}.json", msgspec.json.encode((made_of, for_later)))
    return outcome


def _place(task: Task, part: SplitPart) -> str:
    return f"{_PARTS}/{task.log_key}/{part.index}"


def _made_of(task: Task, part: SplitPart) -> str:
    """What a part's tables depend on, beside the configuration."""
    return f"{task.content_key} {part}"


def _finished(data: bytes, made_of: str) -> Outcome | None:
    try:
        was_made_of, outcome = msgspec.json.decode(data, type=tuple[str, Outcome])
    except msgspec.DecodeError:
        return None
    return replace(outcome, frames_before=outcome.frames) if was_made_of == made_of else None


def joined_parts(task: Task, ended: EndedParts, folder: Path) -> Outcome:
    """Join the tables of all parts, and put them into the dataset.

    Args:
        task: of the log.
        ended: its parts.
        folder: for temporary files.

    Raises:
        RoadpercError: a table cannot be read, or parts do not fit together.
    """
    from roadperc_stream.batch.joining import join

    target, log_id = ReplayTarget(folder / "out.mcap"), ended.cut.log_id
    tables = [_fetched_part(task, part, folder) for part in ended.parts]
    if None in tables:
        return Outcome(BUSY)
    joined = join(log_id, [table for table in tables if table is not None])
    for note in joined.notes:
        print_line(f"note: {note}")
    write_table(target.metrics, joined.metrics)
    write_table(target.objects, joined.objects)
    outcome = publish(task, target, log_id, ended.cut.first_ns, _together([part.outcome for part in ended.parts]))
    for part in ended.parts:
        for suffix in ("json", "metrics.parquet", "objects.parquet"):
            task.out.remove(f"{_place(task, part.part)}.{suffix}")
    if task.out.is_local:
        with suppress(OSError):  # parts of other logs are in it
            for folder_of_parts in (f"{_PARTS}/{task.log_key}", _PARTS):
                task.out.path(folder_of_parts).rmdir()
    return outcome


def _fetched_part(task: Task, ended: EndedPart, folder: Path) -> "PartTables | None":
    """The tables of a part; None where another batch has joined them and removed them."""
    target = ReplayTarget(folder / f"{ended.part.index}.mcap")
    for name, path in (("metrics", target.metrics), ("objects", target.objects)):
        data = task.out.read(f"{_place(task, ended.part)}.{name}.parquet")
        if data is None:
            return None
        path.write_bytes(data)
    return read_part(ended.part, target.path)


def _together(outcomes: list[Outcome]) -> Outcome:
    """What is known of all parts; messages in the seconds that two have in common count in both."""
    return Outcome(
        "done",
        dropped=sum(item.dropped for item in outcomes),
        unreadable=sum(item.unreadable for item in outcomes),
        warnings=tuple(dict.fromkeys(text for item in outcomes for text in item.warnings)),
        seconds=sum(item.seconds for item in outcomes),
        peak_memory_mb=max((item.peak_memory_mb or 0.0 for item in outcomes), default=0.0),
    )


def print_remarks(summary: ReplaySummary, task: Task, folder: Path) -> None:
    """Print what a person should know of a replay: it comes to stand beside the dataset's tables."""
    for remark in summary.remarks:
        print_line(with_addresses(remark, task, folder))
