"""Pairs of runs on rendered logs, some with an injected regression, and what compare says of them."""

import shutil
import tempfile
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

from roadperc_stream.cli import convert
from roadperc_stream.cli.replay import main as replay
from roadperc_stream.eval.compare.comparison import compare_runs
from roadperc_stream.eval.compare.pairing import logged_runs, pair_runs
from roadperc_stream.eval.options import Rules
from roadperc_stream.system.files import METRICS_SUFFIX, OBJECTS_SUFFIX
from roadperc_stream.tools.scene.job import render_dump
from roadperc_stream.tools.scene.options import RenderOptions
from tests.gate_rates.injections import INJECTIONS, TIMES, Tables

SCENES = ("straight", "bend", "hill", "town", "bend", "town")
PAIRS = 200
TRIALS = 40


class Trial(NamedTuple):
    """A pair of runs, and the name of the regression in the new one; empty for none."""

    name: str
    base: Path
    new: Path
    seed: int


def render(folder, number):
    """The log of a scene, rendered if it does not exist."""
    log = folder / f"log_{number}.mcap"
    if not log.exists():
        dump = folder / f"dump_{number}"
        options = RenderOptions(
            width=320, height=240, scene=SCENES[number], seed=51 + number, seconds=5.0, tag_noise=0.02, depth_noise=0.01
        )
        render_dump(dump, options, force=True)
        _require(convert.main([str(dump), str(log), "--quiet"]), log)
        shutil.rmtree(dump)
    return log


def replayed(folder, logs, seed):
    """The folder with the tables of a seed; logs without tables are replayed."""
    results = folder / f"seed_{seed}"
    results.mkdir(exist_ok=True)
    for log in logs:
        if not (results / f"{log.stem}{METRICS_SUFFIX}").exists():
            options = ["--set", f"seed={seed}", "--threads", "1", "--results-only", "--quiet", "--force"]
            _require(replay([str(log), str(results / log.name), *options]), log)
            (results / log.name).unlink()
    return results


def _require(code, log):
    if code != 0:
        raise RuntimeError(f"{log}: cannot be made")


def trials(runs):
    """All trials: pairs without a regression, then those of each regression."""
    random = np.random.default_rng(0)
    pairs = random.permutation(list(combinations(range(len(runs)), 2)))
    chosen = [("", pair) for pair in pairs[:PAIRS]]
    chosen += [(name, pairs[random.integers(len(pairs))]) for name in INJECTIONS for _ in range(TRIALS)]
    return [Trial(name, runs[pair[0]], runs[pair[1]], seed) for seed, (name, pair) in enumerate(chosen)]


def alarms(trial):
    """What compare reports as worse."""
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


def _paths(folder):
    return sorted(folder.glob(f"*{METRICS_SUFFIX}"))


def _objects(path):
    return path.with_name(path.name.removesuffix(METRICS_SUFFIX) + OBJECTS_SUFFIX)


def _tables(folder):
    return [Tables(pl.read_parquet(path), pl.read_parquet(_objects(path))) for path in _paths(folder)]
