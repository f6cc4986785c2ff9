"""Measurements in turn: each job once a round, so that what disturbs the machine disturbs all of them alike."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

from roadperc_stream.core.text import print_line

from .control import measure as control

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
