"""What a simulated fleet starts from: lengths and costs of logs, and what this machine's driver and readers take."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
import polars as pl

from roadperc_stream.batch.backend import Frames
from roadperc_stream.batch.configuration import BatchConfiguration
from roadperc_stream.batch.driver import Driver
from roadperc_stream.batch.job import BatchJob
from roadperc_stream.batch.plan import Again, Planner
from roadperc_stream.batch.runs import KnownRuns, RunsTable
from roadperc_stream.batch.task import DriveFiles, Outcome, Task
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.errors import TableError
from roadperc_stream.schemas.columns.runs import RUN_TIME_COLUMNS
from roadperc_stream.storage.folder import Folder
from roadperc_stream.storage.stored import StoredFile

from .fleet import FleetCosts

MEDIAN_S: Final = 120.0
SIGMA: Final = 1.0
"""Of the lognormal lengths that stand for logs where none have been measured: most of minutes, few of an hour."""
_TOTAL: Final = "total_s"


def usual_lengths(logs: int, seed: int) -> list[float]:
    """Lengths of logs, seconds, where none have been measured."""
    return list(np.random.default_rng(seed).lognormal(np.log(MEDIAN_S), SIGMA, logs))


def measured(runs: Path, logs: int, seed: int, costs: FleetCosts) -> tuple[list[float], FleetCosts]:
    """Lengths drawn from those of a list of runs, and what replaying them took.

    Args:
        runs: a dataset's ``runs.parquet``.
        logs: how many lengths to draw.
        seed: of the draw.
        costs: what the list does not tell.

    Raises:
        TableError: it cannot be read, or no log in it is done.
    """
    columns = ["status", "frames", "duration_s", "size_bytes", "seconds", _TOTAL]
    try:
        done = pl.read_parquet(runs, columns=columns).filter(status="done").filter(pl.col("frames") > 1)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise TableError(f"{runs}: expected a list of runs: {error}") from None
    if not done.height:
        raise TableError(f"{runs}: no log in it is done")
    sums = {name: float(done[name].sum()) for name in columns[1:]}
    found = replace(
        costs,
        frames_per_s=sums["frames"] / sums["duration_s"],
        frame_s=sums[_TOTAL] / sums["frames"],
        frame_bytes=sums["size_bytes"] / sums["frames"],
        start_s=max(0.0, (sums["seconds"] - sums[_TOTAL]) / done.height),
    )
    drawn = np.random.default_rng(seed).choice(done["duration_s"].to_numpy(), logs)
    return list(drawn), found


class _Done:
    """A back end that has done every task at once."""

    def __init__(self, slots: int) -> None:
        self.slots = slots
        self.at_work: dict[str, Frames] = {}
        self._tasks: list[Task] = []

    def submit(self, task: Task) -> None:
        self._tasks.append(task)

    def wait(self, _timeout_s: float) -> list[tuple[Task, Outcome]]:
        times = dict.fromkeys(RUN_TIME_COLUMNS, 1.0)
        tasks, self._tasks = self._tasks, []
        return [(task, Outcome("done", log_id=task.key, date="2020-01-01", stages_s=times)) for task in tasks]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing was begun that would have to end."""


def driver_s(logs: int, slots: int, folder: Path) -> float:
    """The driver's processor time for each of so many logs: planning, giving, taking, writing down.

    Args:
        logs: how many.
        slots: workers that end at once.
        folder: gets a list of runs.
    """
    job = BatchJob(BatchConfiguration(ReplayConfig()), Folder(str(folder)))
    table = RunsTable(job.out)
    started = time.process_time()
    known = KnownRuns(table.read().values(), job.how.name)
    planner = Planner(known, job.out, Again())
    steps = [planner.step(drive) for drive in _drives(logs)]
    Driver(job, _Done(slots), table, known).run(steps)
    table.fold()
    return (time.process_time() - started) / logs


def _drives(logs: int) -> Iterator[DriveFiles]:
    for number in range(logs):
        yield DriveFiles((StoredFile(f"/drives/drive_{number:06d}.mcap", 10**8 + number, f"{number}:{number}"),))


def scan_s(files: int, rows: int, folder: Path) -> float:
    """What polars takes for a file of a dataset in a group-by over all files.

    Args:
        files: how many to write and to read.
        rows: of each.
        folder: gets them.
    """
    columns: dict[str, Any] = {f"value_{number}": np.arange(rows) * 0.5 for number in range(100)}
    for number in range(files):
        day = folder / f"date=2020-01-{1 + number % 28:02d}"
        day.mkdir(parents=True, exist_ok=True)
        pl.DataFrame({"log_id": f"{number:016x}", **columns}).write_parquet(day / f"{number:016x}.parquet")
    started = time.perf_counter()
    groups = pl.scan_parquet(folder / "**/*.parquet", hive_partitioning=True).group_by("log_id")
    found = groups.agg(pl.col("value_0", "value_1").mean()).collect()
    if found.height != files:
        raise TableError(f"{folder}: expected {files} logs, found {found.height}")
    return (time.perf_counter() - started) / files


def quantiles(lengths_s: Sequence[float]) -> tuple[float, float, float]:
    """Median, 99th percentile and maximum of lengths, seconds."""
    half, most = np.quantile(lengths_s, [0.5, 0.99])
    return float(half), float(most), max(lengths_s)
