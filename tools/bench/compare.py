"""Compare the speed with an earlier commit: alternating replays of both versions, ratios with confidence intervals.

Run ``make bench-compare BASE=<commit>`` or ``python -m roadperc_stream.tools.bench.compare FOLDER BASE``. The exit code
is 1 if a quantity is slower by more than the allowed share, with the given confidence.

The logarithms of the rounds' ratios scatter around the true ratio, with a few large outliers. The estimate of Hodges
and Lehmann is the median of all pairwise means (Walsh averages). The interval lies between two of these means, by the
distribution of Wilcoxon's signed ranks. It is exact for symmetric scatter.
Source: Hollander, Wolfe and Chicken, Nonparametric Statistical Methods, 3.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Final, Literal

import numpy as np

from roadperc_stream.cli.launch import run
from roadperc_stream.cli.values import whole_number
from roadperc_stream.errors import RegressionError
from roadperc_stream.system.text import print_line

from .figures import LOGS, Measure, Series, cell, markdown, measured, noise
from .inputs import BenchLog, add_input_arguments, logs_of
from .replays import installed, replay_cost

Verdict = Literal["slower", "faster", "no difference shown"]


@dataclass(frozen=True)
class Ratio:
    """New over base: the estimate and its confidence interval."""

    middle: float
    low: float
    high: float

    def verdict(self, share: float) -> "Verdict":
        """Return "slower" if the interval is above 1 + share, "faster" if it is below 1."""
        if self.low > 1 + share:
            return "slower"
        return "faster" if self.high < 1 else "no difference shown"


def ratio_of(base: Sequence[float], new: Sequence[float], confidence: float) -> Ratio:
    """Return the ratio of two versions' times, positive values of the same rounds.

    The interval is unbounded if the rounds are too few for the confidence, such as 0.99.
    """
    logs = np.log(np.asarray(new, float) / np.asarray(base, float))
    first, second = np.triu_indices(len(logs))
    averages = np.sort((logs[first] + logs[second]) / 2)
    below = np.cumsum(signed_rank_probabilities(len(logs)))
    # The interval excludes ``beyond - 1`` sorted averages at each end.
    beyond = int(np.searchsorted(below, (1 - confidence) / 2, side="right"))
    if not beyond:
        return Ratio(float(np.exp(np.median(averages))), 0.0, np.inf)
    low, middle, high = np.exp([averages[beyond - 1], np.median(averages), averages[-beyond]]).tolist()
    return Ratio(low=low, middle=middle, high=high)


def signed_rank_probabilities(count: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the probability of each sum of ranks 0 to n (n + 1) / 2, with each of the ranks 1 to n in it or not."""
    ways = np.ones(1)
    for rank in range(1, count + 1):
        ways = np.pad(ways, (0, rank)) + np.pad(ways, (rank, 0))
    return ways / 2.0**count


BASE, NEW = "base", "new"
_WHOLE: Final = {
    "cpu": "cpu",
    "wall": "wall",
    "first frame/cpu": "start, with the first frame",
    "peak_mb": "peak memory, MB",
}
"""Titles of the quantities other than parts."""
_PART: Final = "part/"
_SMALL: Final = 0.01
"""Share of a frame's time; smaller parts have no verdict."""


@dataclass(frozen=True)
class Compared:
    """A quantity of both versions, in ms per frame unless its name says otherwise.

    ``ratio`` and ``verdict`` are None if a version lacks the quantity. Small parts have no verdict.
    """

    log: str
    name: str
    base: float | None
    new: float | None
    ratio: Ratio | None
    verdict: Verdict | None

    @property
    def cells(self) -> tuple[str, ...]:
        """Return the row of a table."""
        ratio = (None, None, None) if self.ratio is None else astuple(self.ratio)
        return (self.name, cell(self.base, 2), cell(self.new, 2), *(cell(v, 3) for v in ratio), self.verdict or "")


def main(argv: list[str] | None = None) -> int:
    """Run the comparison; return 0, or 1 if a quantity is slower or an error occurs."""
    parser = argparse.ArgumentParser(prog="python -m roadperc_stream.tools.bench.compare", description=__doc__)
    add_input_arguments(parser)
    parser.add_argument("base", metavar="BASE", help="a commit of this project")
    parser.add_argument(
        "--logs", type=_logs, default=("png", "stereo"), metavar="NAMES", help="some of png,jpeg,stereo,truth"
    )
    parser.add_argument(
        "--rounds", type=whole_number, default=10, metavar="N", help="runs of each job, at least 8 (10)"
    )
    parser.add_argument("--threads", type=whole_number, default=1, metavar="N", help="threads of both versions (1)")
    parser.add_argument("--share", type=float, default=0.03, help="smallest slowdown that counts (0.03)")
    parser.add_argument("--confidence", type=float, default=0.99, help="confidence of the intervals (0.99)")
    arguments = parser.parse_args(argv)
    return run(lambda: _compare(arguments))


def _logs(text: str) -> tuple[str, ...]:
    names = tuple(text.split(","))
    if not set(names) <= set(LOGS):
        raise argparse.ArgumentTypeError(f"{text}: expected some of {','.join(LOGS)}")
    return names


def _compare(arguments: argparse.Namespace) -> None:
    logs = [log for name, log in logs_of(arguments).items() if name in arguments.logs]
    print_line(f"installing {arguments.base}")
    with installed(arguments.base) as package:
        series = measured(_jobs(arguments.folder, logs, package, arguments.threads), arguments.rounds)
    rows = [row for log in logs for row in compared(series, log.name, arguments.share, arguments.confidence)]
    for log in logs:
        headers = (f"{log.name}, ms a frame", "base", "new", "new / base", "from", "to", "")
        print(markdown(headers, [row.cells for row in rows if row.log == log.name]))
    print_line(f"noise of the control: {noise(series):.0%}")
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    slower = [f"{row.log}: {row.name}" for row in rows if row.verdict == "slower"]
    if slower:
        raise RegressionError(f"slower than {arguments.base} by more than {arguments.share:.0%}: {', '.join(slower)}")


def _jobs(folder: Path, logs: list[BenchLog], base: Path, threads: int) -> dict[str, Measure]:
    """Return the jobs by name; the two versions of a log follow each other."""
    return {
        (job := f"{version} {log.name}"): partial(
            replay_cost, job, log, folder / f"compared-{version}.mcap", threads, package
        )
        for log in logs
        for version, package in ((BASE, base), (NEW, None))
    }


def compared(series: Series, log: str, share: float, confidence: float) -> list[Compared]:
    """Return all quantities of a log that a version has, totals first."""
    names = dict.fromkeys(_WHOLE)
    for version in (BASE, NEW):
        start = f"{version} {log}/{_PART}"
        names |= dict.fromkeys(_PART + key.removeprefix(start) for key in series if key.startswith(start))
    return [_compared(series, log, name, share, confidence) for name in names]


def _compared(series: Series, log: str, name: str, share: float, confidence: float) -> Compared:
    base, new = (series.get(f"{version} {log}/{name}") for version in (BASE, NEW))
    title = _WHOLE.get(name, name.removeprefix(_PART))
    if base is None or new is None or min(*base, *new) <= 0:
        return Compared(log, title, median(base) if base else None, median(new) if new else None, None, None)
    ratio = ratio_of(base, new, confidence)
    small = name not in _WHOLE and median(base + new) < _SMALL * median(series[f"{BASE} {log}/cpu"])
    return Compared(log, title, median(base), median(new), ratio, None if small else ratio.verdict(share))


if __name__ == "__main__":
    sys.exit(main())
