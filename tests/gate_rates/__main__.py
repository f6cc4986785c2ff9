"""Measures how often compare is wrong: alarms between runs that differ in the seed only, injected regressions found.

Rendered logs with 2 % tag and 1 % depth noise are replayed with several seeds. The random numbers are fixed.
"""

import argparse
import re
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import combinations
from multiprocessing import get_context
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import polars as pl

from roadperc_stream.cli import convert
from roadperc_stream.cli.plumbing import run
from roadperc_stream.cli.replay import main as replay
from roadperc_stream.errors import RoadpercError
from roadperc_stream.eval.comparison.comparing import compare_runs
from roadperc_stream.eval.comparison.pairing import logged_runs, pair_runs
from roadperc_stream.eval.options import Rules
from roadperc_stream.system.files import METRICS_SUFFIX, OBJECTS_SUFFIX
from roadperc_stream.tools.scene.job import render_dump
from roadperc_stream.tools.scene.options import RenderOptions
from tests.gate_rates.injections import INJECTIONS, TIMES, Tables

SCENES: Final = ("straight", "bend", "hill", "town", "bend", "town")
SEEDS: Final = 21
PAIRS: Final = 200
TRIALS: Final = 40
MOST_ALARMS: Final = 4
FEWEST_FOUND: Final = 38
_BLOCK: Final = re.compile(r"(<!-- gate rates -->\n).*?(<!-- end -->)", re.DOTALL)


class Trial(NamedTuple):
    """A pair of runs, and the name of the regression in the new one; empty for none."""

    name: str
    base: Path
    new: Path
    seed: int


def render(folder: Path, number: int) -> Path:
    """The log of a scene, rendered if it does not exist.

    Raises:
        RoadpercError: the log cannot be written.
    """
    log = folder / f"log_{number}.mcap"
    if not log.exists():
        dump = folder / f"dump_{number}"
        options = RenderOptions(
            width=320, height=240, scene=SCENES[number], seed=number, seconds=5.0, tag_noise=0.02, depth_noise=0.01
        )
        render_dump(dump, options, force=True, on_frame=lambda: None)
        _require(convert.main([str(dump), str(log), "--quiet"]), log)
    return log


def replayed(folder: Path, logs: Sequence[Path], seed: int) -> Path:
    """The folder with the tables of a seed; logs without tables are replayed.

    Raises:
        RoadpercError: a replay fails.
    """
    results = folder / f"seed_{seed}"
    results.mkdir(exist_ok=True)
    for log in logs:
        if not (results / f"{log.stem}{METRICS_SUFFIX}").exists():
            options = ["--set", f"seed={seed}", "--threads", "1", "--results-only", "--quiet", "--force"]
            _require(replay([str(log), str(results / log.name), *options]), log)
            (results / log.name).unlink()
    return results


def _require(code: int, log: Path) -> None:
    if code != 0:
        raise RoadpercError(f"{log}: cannot be made")


def trials(runs: Sequence[Path]) -> list[Trial]:
    """All trials: pairs without a regression, then those of each regression."""
    random = np.random.default_rng(0)
    pairs = random.permutation(list(combinations(range(len(runs)), 2)))
    chosen = [("", pair) for pair in pairs[:PAIRS]]
    chosen += [(name, pairs[random.integers(len(pairs))]) for name in INJECTIONS for _ in range(TRIALS)]
    return [Trial(name, runs[pair[0]], runs[pair[1]], seed) for seed, (name, pair) in enumerate(chosen)]


def alarms(trial: Trial) -> list[str]:
    """What compare reports as worse.

    Raises:
        RoadpercError: a table cannot be read.
    """
    with tempfile.TemporaryDirectory() as folder:
        new = Path(folder) if trial.name else trial.new
        if trial.name:
            source = trial.base if trial.name == TIMES else trial.new  # other replays' times have the machine's noise
            logs = INJECTIONS[trial.name](_tables(source), np.random.default_rng(trial.seed))
            for path, tables in zip(_paths(trial.new), logs, strict=True):
                tables.frames.write_parquet(new / path.name)
                tables.objects.write_parquet(_objects(new / path.name))
        pairing = pair_runs(logged_runs(str(trial.base)), logged_runs(str(new)), other_log=False)
        return compare_runs(pairing, None, Rules(times=trial.name == TIMES)).regressions


def _paths(folder: Path) -> list[Path]:
    return sorted(folder.glob(f"*{METRICS_SUFFIX}"))


def _objects(path: Path) -> Path:
    return path.with_name(path.name.removesuffix(METRICS_SUFFIX) + OBJECTS_SUFFIX)


def _tables(folder: Path) -> list[Tables]:
    return [Tables(pl.read_parquet(path), pl.read_parquet(_objects(path))) for path in _paths(folder)]


def table(rates: Sequence[tuple[str, int, int]]) -> str:
    """A Markdown table of the trials with an alarm, from name, alarms and number of trials."""
    lines = ["| new run | trials | required | alarms |", "|---|---|---|---|"]
    for name, found, count in rates:
        required = f"at least {FEWEST_FOUND}" if name else f"at most {MOST_ALARMS}"
        lines.append(f"| {name or 'differs in `seed` only'} | {count} | {required} | {found} |")
    return "".join(f"{line}\n" for line in lines)


def measure(arguments: argparse.Namespace) -> None:
    """Render, replay, compare; print the table, and each unexpected result.

    Raises:
        RoadpercError: a log cannot be made, or a rate is not as required.
    """
    folder = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(arguments.jobs, get_context("spawn")) as pool:
        logs = arguments.logs or list(pool.map(partial(render, folder), range(len(SCENES))))
        seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
        runs = list(pool.map(partial(replayed, folder, logs), seeds))
        every = trials(runs)
        results = list(pool.map(alarms, every, chunksize=4))
    rates = []
    for name in ("", *INJECTIONS):
        found = [(trial, worse) for trial, worse in zip(every, results, strict=True) if trial.name == name]
        rates.append((name, sum(bool(worse) for _, worse in found), len(found)))
        for trial, worse in found:
            if bool(worse) != bool(name):
                print(f"{trial.base} {trial.new} {trial.seed}: {name} worse in {worse}")
    text = table(rates)
    print(text)
    if arguments.page:
        page = arguments.page.read_text(encoding="utf-8")
        arguments.page.write_text(_BLOCK.sub(lambda block: f"{block[1]}{text}{block[2]}", page), encoding="utf-8")
    if rates[0][1] > MOST_ALARMS or any(found < FEWEST_FOUND for _, found, _ in rates[1:]):
        raise RoadpercError("a rate is not as required")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = argparse.ArgumentParser("python -m tests.gate_rates", description=__doc__)
    parser.add_argument("folder", type=Path, help="for logs and tables, which are kept")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--logs", type=Path, nargs="*", help="use these instead of rendered logs")
    parser.add_argument("--page", type=Path, help="page whose table is replaced")
    return run(lambda: measure(parser.parse_args(argv)))


if __name__ == "__main__":
    raise SystemExit(main())
