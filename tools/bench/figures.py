"""Measurements in turn, the figures they give beside those wanted, and both as tables and as JSON."""

import json
import os
import platform
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any, Final

import cv2
import numpy as np

from roadperc_stream import __version__
from roadperc_stream.system.text import print_line

from .inputs import WARM_UP

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


Measure = Callable[[], dict[str, float]]
"""Gives quantities by name, milliseconds a frame where the name says nothing else."""


def measured(jobs: Mapping[str, Measure], rounds: int) -> Series:
    """Run all jobs in turn, again and again, with the control before each of them.

    Args:
        jobs: what is measured, by name, in this order.
        rounds: how often.

    Returns:
        The values of each quantity, one a round; those of the control one a job.
    """
    series: Series = {}
    for index in range(rounds):
        print_line(f"round {index + 1} of {rounds}")
        for job, measure in jobs.items():
            series.setdefault(CONTROL, []).append(control())
            for quantity, value in measure().items():
                series.setdefault(f"{job}/{quantity}", []).append(value)
    return series


def middle(series: Series, quantity: str) -> float | None:
    """The median over the rounds; None of what was not measured."""
    return median(series[quantity]) if quantity in series else None


def parts_of(series: Series, job: str) -> dict[str, float]:
    """Medians of a job's parts by name."""
    start = f"{job}/part/"
    return {name.removeprefix(start): median(values) for name, values in series.items() if name.startswith(start)}


ONE, ALL = "one thread", "all threads"
COMPARED: Final = ("png", "jpeg", "stereo")
"""Logs that the course's method is run on, and whose floor is measured."""
LOGS: Final = (*COMPARED, "truth")
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
    """The job of replaying a log; those of the course's method and of the floor are ``course LOG``, ``floor LOG``."""
    return f"replay {log}, {threads}"


def figures(series: Series) -> list[SpeedFigure]:
    """Every figure that the series show, medians of the rounds; of a ratio those of the same round."""
    png, speeds = replay_name("png", ONE), {"png": 7.0, "jpeg": 9.0, "stereo": 5.0}
    clocks = [("cpu", ONE, log, least) for log, least in speeds.items()]
    clocks += [("wall", ALL, log, least) for log, least in {"png": 10.0, "jpeg": 12.0}.items()]
    asked: list[tuple[str, str, str | None, float | None, float | None]] = [
        (
            f"{log}: times the course's method, {clock}, {threads}",
            f"course {log}/{clock}",
            f"{replay_name(log, threads)}/{clock}",
            least,
            None,
        )
        for clock, threads, log, least in clocks
    ]
    asked += [(f"gate, {log}", f"{replay_name(log, ONE)}/cpu", f"floor {log}/cpu", None, 1.5) for log in COMPARED]
    asked += [
        ("objects: p95 over median", f"{png}/objects p95 over median", None, None, 4.0),
        ("parts over their total", f"{png}/parts over total", None, 0.97, 1.03),
        ("frames' totals over the replay's cpu", f"{png}/part/total", f"{png}/cpu", None, None),
        ("peak memory with stereo, MB", f"{replay_name('stereo', ONE)}/peak_mb", None, None, 500.0),
    ]
    for start, quantity, most in (("--help", HELP, 1.7), ("first frame", f"{png}/first frame", 6.0)):
        asked += [
            (f"{start} over {BARE}, {clock}", f"{quantity}/{clock}", f"{BARE}/{clock}", None, most)
            for clock in ("cpu", "wall")
        ]
    found = ((name, _median_of(series, above, below), least, most) for name, above, below, least, most in asked)
    return [SpeedFigure(name, value, least, most) for name, value, least, most in found if value is not None]


def _median_of(series: Series, quantity: str, over: str | None) -> float | None:
    """Median of a quantity, or of its ratio to another; None where one was not measured."""
    if over is None or quantity not in series or over not in series:
        return middle(series, quantity) if over is None else None
    return median(a / b for a, b in zip(series[quantity], series[over], strict=True))


def noise(series: Series) -> float:
    """How far the slowest run of the control lies above its fastest one, as a share of their median."""
    values = series[CONTROL]
    return (max(values) - min(values)) / median(values)


_MET: Final = {None: "", True: "met", False: "missed"}


def tables(series: Series, found: Sequence[SpeedFigure]) -> list[str]:
    """Times of each run, of each part, and what is wanted, with the machine's noise."""
    control = series[CONTROL]
    return [
        _runs(series),
        _parts(series, "a replay with one thread", {name: replay_name(name, ONE) for name in LOGS}),
        _parts(series, "the course's method", {name: f"course {name}" for name in COMPARED}),
        _parts(series, "the floor", {name: f"floor {name}" for name in COMPARED}),
        figures_table(found),
        f"The same work between all runs took {median(control):.0f} ms of a processor, {min(control):.0f} to "
        f"{max(control):.0f}: noise of {noise(series):.0%}.",
    ]


def markdown(headers: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown: docs/performance.md takes it as it is."""
    lines = (headers, ("---", *("---:" for _ in headers[1:])), *rows)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n"


def cell(value: float | None, decimals: int = 1) -> str:
    """A number in a table; empty for None."""
    return "" if value is None else f"{value:.{decimals}f}"


def figures_table(found: Sequence[SpeedFigure]) -> str:
    """A row a figure."""
    rows = ((item.name, f"{item.value:.2f}", _MET[item.met], item.wanted) for item in found)
    return markdown(("figure", "measured", "", "wanted"), rows)


def _runs(series: Series) -> str:
    names = dict.fromkeys(key.split("/")[0] for key in series if key != CONTROL)
    quantities = {"cpu": 1, "wall": 1, "peak_mb": 0, "first frame/wall": 0}
    rows = (
        (name, *(cell(middle(series, f"{name}/{key}"), decimals) for key, decimals in quantities.items()))
        for name in names
    )
    note = f"Medians of the rounds; of a log a frame, without the start: what its first {WARM_UP} frames alone take."
    return markdown(("run", "cpu ms", "wall ms", "peak MB", "first frame ms"), rows) + f"\n{note}\n"


def _parts(series: Series, title: str, jobs: dict[str, str]) -> str:
    """A column a log, a row a part, the parts' sum last where nothing gives a total."""
    columns = {log: parts for log, job in jobs.items() if (parts := parts_of(series, job))}
    names = dict.fromkeys(name for parts in columns.values() for name in parts)
    if "total" not in names:
        columns = {log: {**parts, "total": sum(parts.values())} for log, parts in columns.items()}
    ordered = (*(name for name in names if name != "total"), "total")
    rows = ((name, *(cell(parts.get(name)) for parts in columns.values())) for name in ordered)
    return markdown((f"{title}, ms a frame", *columns), rows)


def write_json(path: Path, series: Series, found: Sequence[SpeedFigure], about: dict[str, Any]) -> None:
    """All of it for programs: the figures, and the values of each quantity, one a round."""
    versions = {"python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__}
    content = {
        "version": __version__,
        "machine": {"processors": os.cpu_count(), **versions},
        **about,
        "figures": [{**asdict(figure), "met": figure.met} for figure in found],
        "series": series,
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
