"""One log through the chain under many configurations at once: read and decoded once, a metrics table for each."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Sample
from roadperc_stream.core.stage_timer import StageTimer
from roadperc_stream.core.threads import one_thread
from roadperc_stream.core.time import TimeRange
from roadperc_stream.input import ReplaySource
from roadperc_stream.output.tables import TableWriter, table_facts
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics
from roadperc_stream.state.opening import open_log
from roadperc_stream.state.replay_state import ReplayMemory
from roadperc_stream.state.running import run_frame

from .settings import Combination, passes

Progress = Callable[[int, int], None]
"""Called with frames done since the last call, and frames found that are yet to be done."""


@dataclass(frozen=True)
class Job:
    """A log, and what becomes of it: ``table`` is the file name of its tables in each combination's folder."""

    source: Path
    table: str
    folder: Path
    combinations: tuple[Combination, ...]
    overrides: Mapping[str, str]
    time_range: TimeRange


@dataclass
class Candidate:
    """A configuration, what it remembers in the log, and its table."""

    cfg: ReplayConfig
    table: TableWriter
    memory: ReplayMemory

    def take(self, log_id: str, sample: Sample) -> None:
        """Run the chain on a sample and add its row, the one a replay under this configuration gives."""
        timer = StageTimer()
        with timer("total"):
            self.memory, _, _, row = run_frame(self.cfg, self.memory, log_id, sample, timer)
        if sample.is_written:
            self.table.append(row, **timer.columns())


def sweep_log(job: Job, progress: Progress) -> tuple[str, ...]:
    """Replay a log under every combination.

    Returns:
        What is worth knowing of the log: roles that were guessed or have no channel, messages that could not be read.

    Raises:
        RoadpercError: the log cannot be read or replayed, or a table cannot be written.
    """
    notes = [note for some in passes(job.combinations) for note in _one_pass(job, some, progress)]
    return tuple(dict.fromkeys(notes))


def _one_pass(job: Job, some: Sequence[Combination], progress: Progress) -> tuple[str, ...]:
    """Take the combinations, which all decode alike, through the log together."""
    opened = open_log(ReplaySource(job.source, job.overrides, job.time_range), some[0].cfg)
    log_in = opened.input
    progress(0, log_in.expected_frames)
    candidates = [Candidate(item.cfg, _table(job, item), opened.memory_for(item.cfg)) for item in some]
    with one_thread(), ExitStack() as tables:
        for candidate in candidates:
            tables.enter_context(candidate.table)
        for sample in log_in.samples():
            for candidate in _by_turns(candidates, sample.index):
                candidate.take(log_in.log_id, sample)
            progress(1, 0)
    return log_in.notes


def _by_turns(candidates: Sequence[Candidate], frame: int) -> list[Candidate]:
    """Another one first in every frame: the first decodes for all, and times are to compare."""
    first = frame % len(candidates)
    return [*candidates[first:], *candidates[:first]]


def _table(job: Job, item: Combination) -> TableWriter:
    path = job.folder / item.folder / job.table
    facts = table_facts(job.source, job.source, item.cfg)
    return TableWriter(path, FrameMetrics, facts, TIME_COLUMNS, item.settings)
