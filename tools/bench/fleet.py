"""A fleet of workers over many logs, simulated event by event: what a batch would take, and what holds it up.

Each worker takes the longest log that is left, as the batch does, starts a process, fetches the log from the store,
replays it and puts its tables back. The store's bandwidth is shared fairly, the driver serves one worker at a time.
"""

import heapq
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any, Literal

import simpy

Bottleneck = Literal["workers", "longest log", "store", "driver"]


@dataclass(frozen=True)
class FleetCosts:
    """What replaying takes.

    Args:
        frames_per_s: of a log.
        frame_s: a processor's time for a frame.
        start_s: a worker's time for a log but for fetching and frames: its process, opening, publishing.
        frame_bytes: of a log in the store.
        result_bytes: of a frame in the tables.
        store_bytes_per_s: what the store gives and takes in all.
        worker_bytes_per_s: what one worker gets of it at most.
        driver_s: the driver's time for a log.
    """

    frames_per_s: float = 20.0
    frame_s: float = 0.0854
    start_s: float = 1.0
    frame_bytes: float = 1.2e6
    result_bytes: float = 600.0
    store_bytes_per_s: float = 1.25e9
    worker_bytes_per_s: float = 1.0e8
    driver_s: float = 0.002

    def work_s(self, length_s: float) -> float:
        """A worker's time for a log of so many seconds, the store's apart."""
        return self.start_s + length_s * self.frames_per_s * self.frame_s

    def fetched_bytes(self, length_s: float) -> float:
        """A log's size."""
        return length_s * self.frames_per_s * self.frame_bytes

    def put_bytes(self, length_s: float) -> float:
        """Size of a log's tables."""
        return length_s * self.frames_per_s * self.result_bytes

    def alone_s(self, length_s: float) -> float:
        """A log from start to end, with nobody else at work."""
        moved_bytes = self.fetched_bytes(length_s) + self.put_bytes(length_s)
        rate = min(self.store_bytes_per_s, self.worker_bytes_per_s)
        return self.driver_s + moved_bytes / rate + self.work_s(length_s)


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


def simulate(lengths_s: Sequence[float], workers: int, costs: FleetCosts) -> FleetRun:
    """Replay logs of these lengths with so many workers."""
    environment = simpy.Environment()
    link = SharedLink(environment, costs.store_bytes_per_s, costs.worker_bytes_per_s)
    driver = simpy.Resource(environment)
    waiting = sorted(lengths_s)

    def worker() -> Generator[simpy.Event, Any, None]:
        while waiting:
            length_s = waiting.pop()
            with driver.request() as turn:
                yield turn
                yield environment.timeout(costs.driver_s)
            yield link.transfer(costs.fetched_bytes(length_s))
            yield environment.timeout(costs.work_s(length_s))
            yield link.transfer(costs.put_bytes(length_s))

    for _ in range(workers):
        environment.process(worker())
    environment.run()
    return FleetRun(workers, float(environment.now), sum(lengths_s), bounds(lengths_s, workers, costs))


def bounds(lengths_s: Sequence[float], workers: int, costs: FleetCosts) -> dict[Bottleneck, float]:
    """The least that a batch can take, seconds: by its workers, its longest log, its store and its driver."""
    alone_s = [costs.alone_s(length_s) for length_s in lengths_s]
    moved_bytes = sum(costs.fetched_bytes(length_s) + costs.put_bytes(length_s) for length_s in lengths_s)
    return {
        "workers": sum(alone_s) / workers,
        "longest log": max(alone_s, default=0.0),
        "store": moved_bytes / costs.store_bytes_per_s,
        "driver": costs.driver_s * len(lengths_s),
    }


def in_parts(lengths_s: Sequence[float], split_s: float, warm_up_s: float) -> list[float]:
    """Lengths of what is replayed at once where logs are split: all parts but the first see a warm-up."""
    parts = []
    for length_s in lengths_s:
        parts.append(min(length_s, split_s))
        begun_s = split_s
        while begun_s < length_s:
            parts.append(min(split_s, length_s - begun_s) + warm_up_s)
            begun_s += split_s
    return parts
