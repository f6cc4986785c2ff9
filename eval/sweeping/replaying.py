"""One log through the chain under many configurations at once: read and decoded once, a metrics table for each."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.chain.step import ChainState, step
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Sample
from roadperc_stream.input.plan import Cut, samples, survey_log
from roadperc_stream.input.roles.fill import Problems
from roadperc_stream.input.sync import SyncCounts
from roadperc_stream.log import LogSummary
from roadperc_stream.metrics import frame_metrics
from roadperc_stream.output.tables import TableWriter
from roadperc_stream.replay import StageTimer, one_thread, table_facts
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics

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
    cut: Cut


@dataclass
class Candidate:
    """A configuration, the state of its chain in the log, and its table."""

    cfg: ReplayConfig
    table: TableWriter
    state: ChainState = field(default_factory=ChainState)

    def take(self, log_id: str, sample: Sample, previous: Sample | None) -> None:
        """Run the chain on a sample and add its row, the one a replay under this configuration gives."""
        timer = StageTimer()
        with timer("total"):
            self.state, result = step(self.cfg, self.state, sample.frame, timer)
            row = frame_metrics(self.cfg, log_id, sample, result, previous)
        self.table.append(row, **timer.columns())


def sweep_log(job: Job, progress: Progress) -> tuple[str, ...]:
    """Replay a log under every combination.

    Returns:
        What is worth knowing of the log: roles that are filled in an unusual way, messages that could not be read.

    Raises:
        RoadpercError: the log cannot be read or replayed, or a table cannot be written.
    """
    summary = log.summarise(job.source)
    notes = [note for some in passes(job.combinations) for note in _one_pass(job, summary, some, progress)]
    return tuple(dict.fromkeys(notes))


def _one_pass(job: Job, summary: LogSummary, some: Sequence[Combination], progress: Progress) -> tuple[str, ...]:
    """Take the combinations, which all decode alike, through the log together."""
    cfg = some[0].cfg
    survey = survey_log(summary, cfg, job.overrides, job.cut)
    progress(0, survey.expected_frames)
    problems, log_id = Problems(), survey.digest[:16]
    candidates = [Candidate(item.cfg, _table(job, item)) for item in some]
    previous: Sample | None = None
    with one_thread(), ExitStack() as tables:
        for candidate in candidates:
            tables.enter_context(candidate.table)
        for sample in samples(summary, survey, cfg, SyncCounts(), problems):
            for candidate in _by_turns(candidates, sample.index):
                candidate.take(log_id, sample, previous)
            previous = sample
            progress(1, 0)
    return (*survey.filled.notes, *(survey.problems.first | problems.first).values())


def _by_turns(candidates: Sequence[Candidate], frame: int) -> list[Candidate]:
    """Another one first in every frame: the first decodes for all, and times are to compare."""
    first = frame % len(candidates)
    return [*candidates[first:], *candidates[:first]]


def _table(job: Job, item: Combination) -> TableWriter:
    path = job.folder / item.folder / job.table
    facts = table_facts(job.source, job.source, item.cfg)
    return TableWriter(path, FrameMetrics, facts, TIME_COLUMNS, item.settings)
