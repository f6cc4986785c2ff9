"""Measurements in turn, and the figures they give beside those wanted."""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from time import process_time
from typing import Final

import cv2
import numpy as np

from roadperc_stream.system.text import print_line

_REPEATS: Final = 8
_SIDE: Final = 512


def control() -> float:
    """Milliseconds of a processor that the work takes: packing, filtering and plain Python, a quarter of a second."""
    pixels = np.random.default_rng(0).integers(0, 32, (_SIDE, _SIDE), np.uint8)
    started = process_time()
    for _ in range(_REPEATS):
        zlib.compress(cv2.GaussianBlur(pixels, (9, 9), 2.0).tobytes(), 6)
        sum(index * index for index in range(100_000))
    return (process_time() - started) * 1000


CONTROL = "control"
Series = dict[str, list[float]]
"""A value a round of each quantity, such as ``replay png, 1 thread/cpu``."""


@dataclass(frozen=True)
class BenchJob:
    """What is measured: ``run`` gives quantities by name, milliseconds a frame where nothing else is said."""

    name: str
    run: Callable[[], dict[str, float]]


def measured(jobs: Sequence[BenchJob], rounds: int) -> Series:
    """Run all jobs in turn, again and again, with the control before each of them.

    Args:
        jobs: what is measured, in this order.
        rounds: how often; each is said when it begins.

    Returns:
        The values of each quantity, one a round; those of the control one a job.
    """
    series: Series = {}
    for index in range(rounds):
        print_line(f"round {index + 1} of {rounds}")
        for job in jobs:
            series.setdefault(CONTROL, []).append(control())
            for quantity, value in job.run().items():
                series.setdefault(f"{job.name}/{quantity}", []).append(value)
    return series


def ratios(series: Series, above: str, below: str) -> list[float]:
    """One quantity over another, round by round."""
    return [a / b for a, b in zip(series[above], series[below], strict=True)]


def middle(series: Series, quantity: str) -> float | None:
    """The median over the rounds; None of what was not measured."""
    return median(series[quantity]) if quantity in series else None


def parts_of(series: Series, job: str) -> dict[str, float]:
    """Medians of a job's parts by name."""
    start = f"{job}/part/"
    return {name.removeprefix(start): median(values) for name, values in series.items() if name.startswith(start)}


ONE, ALL = "one thread", "all threads"
COMPARED = ("png", "jpeg", "stereo")
"""Logs that the course's method is run on, and of which is measured what no replay can do without."""
LOGS = (*COMPARED, "truth")
BARE, HELP = "import numpy, cv2", "--help"


@dataclass(frozen=True)
class SpeedFigure:
    """A figure beside what is wanted of it: no more than ``most``, no less than ``least``."""

    name: str
    value: float
    least: float | None = None
    most: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether it is as wanted; None where nothing is."""
        if self.least is None and self.most is None:
            return None
        return (self.least is None or self.value >= self.least) and (self.most is None or self.value <= self.most)

    @property
    def wanted(self) -> str:
        """What is wanted, as a text."""
        bounds = (("≥", self.least), ("≤", self.most))
        return ", ".join(f"{word} {bound:g}" for word, bound in bounds if bound is not None)


def replay_name(log: str, threads: str) -> str:
    """The job of replaying a log."""
    return f"replay {log}, {threads}"


def course_name(log: str) -> str:
    """The job of the course's method on a log."""
    return f"course {log}"


def floor_name(log: str) -> str:
    """The job of measuring what no replay of a log can do without."""
    return f"floor {log}"


PNG: Final = replay_name("png", ONE)


def figures(series: Series) -> list[SpeedFigure]:
    """Every figure that the series show, medians of ratios of the same round."""
    asked = (
        *_speeds(series, "cpu", ONE, {"png": 7.0, "jpeg": 9.0, "stereo": 5.0}),
        *_speeds(series, "wall", ALL, {"png": 10.0, "jpeg": 12.0}),
        *(_ratio(series, f"gate, {n}", f"{replay_name(n, ONE)}/cpu", f"{floor_name(n)}/cpu", 1.5) for n in COMPARED),
        _plain(series, "objects: p95 over median", f"{PNG}/objects p95 over median", most=4.0),
        _plain(series, "parts over their total", f"{PNG}/parts over total", 0.97, 1.03),
        _ratio(series, "frames' totals over the replay's cpu", f"{PNG}/part/total", f"{PNG}/cpu"),
        _plain(series, "peak memory with stereo, MB", f"{replay_name('stereo', ONE)}/peak_mb", most=500.0),
        *(_ratio(series, f"--help over {BARE}, {c}", f"{HELP}/{c}", f"{BARE}/{c}", 1.7) for c in ("cpu", "wall")),
        *(
            _ratio(series, f"first frame over {BARE}, {c}", f"{PNG}/first frame/{c}", f"{BARE}/{c}", 6.0)
            for c in ("cpu", "wall")
        ),
    )
    return [figure for figure in asked if figure is not None]


def _speeds(series: Series, clock: str, threads: str, least: dict[str, float]) -> list[SpeedFigure | None]:
    """How many times as fast as the course's method."""
    return [
        _ratio(
            series,
            f"{log}: times the course's method, {clock}, {threads}",
            f"{course_name(log)}/{clock}",
            f"{replay_name(log, threads)}/{clock}",
            least=wanted,
        )
        for log, wanted in least.items()
    ]


def _ratio(
    series: Series, name: str, above: str, below: str, most: float | None = None, least: float | None = None
) -> SpeedFigure | None:
    if above not in series or below not in series:
        return None
    return SpeedFigure(name, median(ratios(series, above, below)), least, most)


def _plain(
    series: Series, name: str, quantity: str, least: float | None = None, most: float | None = None
) -> SpeedFigure | None:
    value = middle(series, quantity)
    return None if value is None else SpeedFigure(name, value, least, most)


def noise(series: Series) -> float:
    """How far the slowest run of the control lies above its fastest one, as a share of their median."""
    values = series[CONTROL]
    return (max(values) - min(values)) / median(values)
