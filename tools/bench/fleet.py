"""A fleet of workers over many logs, simulated event by event: what a batch would take, and what holds it up.

Each worker takes the longest log that is left, but parts of one before all else, as the batch does, starts a process,
fetches the log from the store, replays it and puts its tables back. A log that is to be split is first fetched and
checked whole by one worker; its parts then fetch their own bytes. The store's bandwidth is shared fairly, the driver
serves one worker at a time.
"""

import heapq
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from itertools import count
from math import ceil
from typing import Any, Literal, Self

import simpy

Bottleneck = Literal["workers", "longest log", "store", "driver"]


@dataclass(frozen=True)
class FleetCosts:
    """What replaying takes.

    Args:
        frames_per_s: of a log.
        frame_s: a processor's time for a frame.
        cut_s: a processor's time for a frame of a log that is cut into parts: it is checked, and its digest computed.
        start_s: a worker's time for a log but for fetching and frames: its process, opening, publishing.
        frame_bytes: of a log in the store.
        result_bytes: of a frame in the tables.
        store_bytes_per_s: what the store gives and takes in all.
        worker_bytes_per_s: what one worker gets of it at most.
        driver_s: the driver's time for a log.
    """

    frames_per_s: float = 20.0
    frame_s: float = 0.0854
    cut_s: float = 0.0044
    start_s: float = 1.0
    frame_bytes: float = 1.2e6
    result_bytes: float = 600.0
    store_bytes_per_s: float = 1.25e9
    worker_bytes_per_s: float = 1.0e8
    driver_s: float = 0.002

    def job(self, length_s: float) -> "FleetJob":
        """A log, or a part of one, of so many seconds."""
        frames = length_s * self.frames_per_s
        return FleetJob(frames * self.frame_bytes, self.start_s + frames * self.frame_s, frames * self.result_bytes)

    def cutting(self, length_s: float) -> "FleetJob":
        """Before the parts of a log."""
        frames = length_s * self.frames_per_s
        return FleetJob(frames * self.frame_bytes, self.start_s + frames * self.cut_s, 0.0)

    def alone_s(self, job: "FleetJob") -> float:
        """A job from start to end, with nobody else at work."""
        rate = min(self.store_bytes_per_s, self.worker_bytes_per_s)
        return self.driver_s + job.moved_bytes / rate + job.work_s


@dataclass(frozen=True)
class FleetJob:
    """What one worker does in one go: fetch so many bytes, compute for so long, put so many bytes."""

    fetched_bytes: float
    work_s: float
    put_bytes: float

    @property
    def moved_bytes(self) -> float:
        """By the store in all."""
        return self.fetched_bytes + self.put_bytes


@dataclass(frozen=True)
class FleetSplit:
    """Logs are replayed in parts of so many seconds, all but the first of which see a warm-up."""

    part_s: float
    warm_up_s: float

    def parts_s(self, length_s: float) -> list[float]:
        """Lengths of what is replayed at once of a log."""
        begins = range(ceil(length_s / self.part_s))
        return [min(self.part_s, length_s - k * self.part_s) + (self.warm_up_s if k else 0.0) for k in begins]


@dataclass(frozen=True)
class _Log:
    """The jobs of a log: ``parts`` at once, after ``cutting`` where there is one."""

    length_s: float
    cutting: FleetJob | None
    parts: tuple[FleetJob, ...]

    @classmethod
    def of(cls, length_s: float, costs: FleetCosts, split: FleetSplit | None) -> Self:
        parts_s = split.parts_s(length_s) if split is not None else [length_s]
        cutting = costs.cutting(length_s) if len(parts_s) > 1 else None
        return cls(length_s, cutting, tuple(map(costs.job, parts_s)))

    @property
    def jobs(self) -> tuple[FleetJob, ...]:
        return (*([] if self.cutting is None else [self.cutting]), *self.parts)

    def alone_s(self, costs: FleetCosts) -> float:
        """With a worker for each part."""
        cutting_s = 0.0 if self.cutting is None else costs.alone_s(self.cutting)
        return cutting_s + max(map(costs.alone_s, self.parts))


@dataclass(frozen=True)
class FleetRun:
    """A batch as it was simulated.

    Args:
        workers: how many.
        seconds: from the first log's start to the last one's end.
        log_s: seconds of log that were replayed.
        bounds_s: below what no order of the logs gets, by what each bound comes from.
    """

    workers: int
    seconds: float
    log_s: float
    bounds_s: dict[Bottleneck, float]

    @property
    def speed(self) -> float:
        """Seconds of log in a second."""
        return self.log_s / self.seconds

    @property
    def efficiency(self) -> float:
        """Of the workers' time, what is needed where nobody waits for anybody."""
        return self.bounds_s["workers"] / self.seconds

    @property
    def bottleneck(self) -> Bottleneck:
        """What holds it up; more workers help only where it is the workers."""
        return max(self.bounds_s, key=lambda name: self.bounds_s[name])


class SharedLink:
    """A store's bandwidth: all transfers at a time go equally fast.

    Transfers are kept by the bytes that each transfer since the first would have got: one that begins later ends where
    that count has grown by its size (Parekh and Gallager's virtual time, for equal shares).
    """

    def __init__(self, environment: simpy.Environment, total_bytes_per_s: float, each_bytes_per_s: float) -> None:
        self._environment, self._total, self._each = environment, total_bytes_per_s, each_bytes_per_s
        self._ends: list[tuple[float, int, simpy.Event]] = []
        self._given, self._at_s, self._turn = 0.0, 0.0, 0
        self._number = count()

    def transfer(self, size_bytes: float) -> simpy.Event:
        """An event at the end of a transfer that begins now."""
        self._advance()
        done = self._environment.event()
        heapq.heappush(self._ends, (self._given + size_bytes, next(self._number), done))
        self._wake()
        return done

    def _rate(self) -> float:
        return min(self._each, self._total / len(self._ends)) if self._ends else 0.0

    def _advance(self) -> None:
        self._given += self._rate() * (self._environment.now - self._at_s)
        self._at_s = self._environment.now

    def _wake(self) -> None:
        """At the end of the transfer that is next, unless another begins before."""
        self._turn += 1
        if self._ends:
            self._environment.process(self._end_next(self._turn))

    def _end_next(self, turn: int) -> Generator[simpy.Event, Any, None]:
        yield self._environment.timeout(max(0.0, self._ends[0][0] - self._given) / self._rate())
        if turn != self._turn:
            return
        self._advance()
        end_bytes, _, done = heapq.heappop(self._ends)
        self._given = max(self._given, end_bytes)  # rounding must not leave a crumb of it
        done.succeed()
        self._wake()


def simulate(lengths_s: Sequence[float], workers: int, costs: FleetCosts, split: FleetSplit | None = None) -> FleetRun:
    """Replay logs of these lengths with so many workers, in parts where a split is given."""
    environment = simpy.Environment()
    link = SharedLink(environment, costs.store_bytes_per_s, costs.worker_bytes_per_s)
    driver = simpy.Resource(environment)
    waiting = simpy.PriorityStore(environment)
    end_s = 0.0

    def give(log: _Log, *jobs: FleetJob, first: bool = False) -> None:
        for job in jobs:
            waiting.put(simpy.PriorityItem((not first, -log.length_s), (log, job)))

    def worker() -> Generator[simpy.Event, Any, None]:
        nonlocal end_s
        while True:
            log, job = (yield waiting.get()).item
            with driver.request() as turn:
                yield turn
                yield environment.timeout(costs.driver_s)
            yield link.transfer(job.fetched_bytes)
            yield environment.timeout(job.work_s)
            yield link.transfer(job.put_bytes)
            if job is log.cutting:
                give(log, *log.parts, first=True)
            end_s = environment.now

    logs = [_Log.of(length_s, costs, split) for length_s in lengths_s]
    for log in logs:
        give(log, *log.jobs[:1])
    for _ in range(workers):
        environment.process(worker())
    environment.run()
    return FleetRun(workers, end_s, sum(lengths_s), bounds(lengths_s, workers, costs, split))


def bounds(
    lengths_s: Sequence[float], workers: int, costs: FleetCosts, split: FleetSplit | None = None
) -> dict[Bottleneck, float]:
    """The least that a batch can take, seconds: by its workers, its longest log, its store and its driver."""
    logs = [_Log.of(length_s, costs, split) for length_s in lengths_s]
    jobs = [job for log in logs for job in log.jobs]
    return {
        "workers": sum(map(costs.alone_s, jobs)) / workers,
        "longest log": max((log.alone_s(costs) for log in logs), default=0.0),
        "store": sum(job.moved_bytes for job in jobs) / costs.store_bytes_per_s,
        "driver": costs.driver_s * len(jobs),
    }
