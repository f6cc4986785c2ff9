"""Run measurements in rounds, compute figures with their limits, and write both as tables and JSON."""

import json
import math
import os
import platform
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any, Final

import cv2
import numpy as np

from roadperc_stream import __version__
from roadperc_stream.system.text import print_line

from .inputs import WARM_UP

CONTROL: Final = "control"
COMPARED: Final = ("png", "jpeg", "stereo")
"""Logs for the course method."""
LOGS: Final = (*COMPARED, "truth")
BARE, HELP = "import numpy, cv2", "--help"
ONE, ALL = "one thread", "all threads"
Series = dict[str, list[float]]
"""One value per round for each quantity, such as ``replay png, one thread/cpu``."""
Measure = Callable[[], dict[str, float]]
"""Returns quantities by name, in ms per frame unless the name says otherwise."""


def control() -> float:
    """Return the CPU time in ms of a fixed workload: compression, filtering and Python code, about 250 ms."""
    pixels = np.random.default_rng(0).integers(0, 32, (512, 512), np.uint8)
    started = process_time()
    for _ in range(8):
        zlib.compress(cv2.GaussianBlur(pixels, (9, 9), 2.0).tobytes(), 6)
        sum(index * index for index in range(100_000))
    return (process_time() - started) * 1000


def measured(jobs: Mapping[str, Measure], rounds: int) -> Series:
    """Run all jobs in order, once per round, with the control before each job.

    Returns:
        The values of each quantity, one per round; the control has one value per job and round.
    """
    series: Series = {}
    for index in range(rounds):
        print_line(f"round {index + 1} of {rounds}")
        for job, measure in jobs.items():
            series.setdefault(CONTROL, []).append(control())
            for quantity, value in measure().items():
                series.setdefault(f"{job}/{quantity}", []).append(value)
    return series


@dataclass(frozen=True)
class SpeedFigure:
    """A quantity, or its ratio to another quantity of the same round, with its limits."""

    name: str
    quantity: str
    over: str | None = None
    least: float = -math.inf
    most: float = math.inf

    @property
    def wanted(self) -> str:
        """Return the limits as text."""
        bounds = (("≥", self.least), ("≤", self.most))
        return ", ".join(f"{sign} {bound:g}" for sign, bound in bounds if math.isfinite(bound))

    def met(self, value: float) -> str:
        """Return ``met`` or ``missed``, or an empty text without limits."""
        return "" if not self.wanted else "met" if self.least <= value <= self.most else "missed"


def replay_name(log: str, threads: str) -> str:
    """Return the name of a replay job; the other jobs are ``course LOG``."""
    return f"replay {log}, {threads}"


def _over_replay(log: str, clock: str, threads: str, least: float) -> SpeedFigure:
    name = f"{log}: course method over replay, {clock}, {threads}"
    return SpeedFigure(name, f"course {log}/{clock}", f"{replay_name(log, threads)}/{clock}", least=least)


_PNG: Final = replay_name("png", ONE)
FIGURES: Final = (
    *(_over_replay(log, "cpu", ONE, least) for log, least in (("png", 12), ("jpeg", 14), ("stereo", 5))),
    *(_over_replay(log, "wall", ALL, least) for log, least in (("png", 16), ("jpeg", 20))),
    SpeedFigure("objects: p95 over median", f"{_PNG}/objects p95 over median", most=4),
    SpeedFigure("sum of parts over total", f"{_PNG}/parts over total", least=0.97, most=1.03),
    SpeedFigure("total of frames over cpu of replay", f"{_PNG}/part/total", f"{_PNG}/cpu"),
    SpeedFigure("peak memory with stereo, MB", f"{replay_name('stereo', ONE)}/peak_mb", most=500),
    *(
        SpeedFigure(f"{start} over {BARE}, {clock}", f"{quantity}/{clock}", f"{BARE}/{clock}", most=most)
        for start, quantity, most in (("--help", HELP, 1.7), ("first frame", f"{_PNG}/first frame", 6))
        for clock in ("cpu", "wall")
    ),
)


def figures(series: Series) -> list[tuple[SpeedFigure, float]]:
    """Return the measured figures with their values: medians over the rounds, of ratios within a round."""
    found = ((figure, median_of(series, figure.quantity, figure.over)) for figure in FIGURES)
    return [(figure, value) for figure, value in found if value is not None]


def median_of(series: Series, quantity: str, over: str | None = None) -> float | None:
    """Return the median of a quantity, or of its ratio to another; None if one was not measured."""
    if quantity not in series or (over is not None and over not in series):
        return None
    values = series[quantity]
    return median(values if over is None else (a / b for a, b in zip(values, series[over], strict=True)))


def noise(series: Series) -> float:
    """Return the range of the control's times as a share of their median."""
    values = series[CONTROL]
    return (max(values) - min(values)) / median(values)


def tables(series: Series) -> list[str]:
    """Return the times of runs and parts, the figures, and the noise of the machine."""
    control = series[CONTROL]
    rows = ((figure.name, f"{value:.2f}", figure.met(value), figure.wanted) for figure, value in figures(series))
    return [
        _runs(series),
        _parts(series, "a replay with one thread", {name: replay_name(name, ONE) for name in LOGS}),
        _parts(series, "the course method", {name: f"course {name}" for name in COMPARED}),
        markdown(("figure", "measured", "", "wanted"), rows),
        f"Control workload: {median(control):.0f} ms of CPU time, {min(control):.0f} to {max(control):.0f}: noise of "
        f"{noise(series):.0%}.",
    ]


def markdown(headers: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown, as in docs/performance.md."""
    lines = (headers, ("---", *("---:" for _ in headers[1:])), *rows)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n"


def cell(value: float | None, decimals: int = 1) -> str:
    """Return a number for a table, empty for None."""
    return "" if value is None else f"{value:.{decimals}f}"


def _runs(series: Series) -> str:
    names = dict.fromkeys(key.split("/")[0] for key in series if key != CONTROL)
    quantities = {"cpu": 1, "wall": 1, "peak_mb": 0, "first frame/wall": 0}
    rows = (
        (name, *(cell(median_of(series, f"{name}/{key}"), decimals) for key, decimals in quantities.items()))
        for name in names
    )
    note = f"Medians of the rounds, per frame without the start (the time of the first {WARM_UP} frames alone)."
    return markdown(("run", "cpu ms", "wall ms", "peak MB", "first frame ms"), rows) + f"\n{note}\n"


def parts_of(series: Series, job: str) -> dict[str, float]:
    """Return the medians of a job's parts by name."""
    start = f"{job}/part/"
    return {name.removeprefix(start): median(values) for name, values in series.items() if name.startswith(start)}


def _parts(series: Series, title: str, jobs: dict[str, str]) -> str:
    """Return a table with a column per log and a row per part; the last row is the total or the sum."""
    columns = {log: parts for log, job in jobs.items() if (parts := parts_of(series, job))}
    for parts in columns.values():
        parts["total"] = parts.pop("total", sum(parts.values()))
    names = dict.fromkeys(name for parts in columns.values() for name in parts)
    ordered = (*(name for name in names if name != "total"), "total")
    rows = ((name, *(cell(parts.get(name)) for parts in columns.values())) for name in ordered)
    return markdown((f"{title}, ms a frame", *columns), rows)


def write_json(path: Path, series: Series, about: dict[str, Any]) -> None:
    """Write the figures, and the values of each quantity, as JSON."""
    versions = {"python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__}
    content = {
        "version": __version__,
        "machine": {"processors": os.cpu_count(), **versions},
        **about,
        "figures": [
            {"name": figure.name, "value": value, "wanted": figure.wanted, "met": figure.met(value)}
            for figure, value in figures(series)
        ],
        "series": series,
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
