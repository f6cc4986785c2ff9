"""Renders and replays the scenarios of the figures in parallel, and returns the tables."""

import contextlib
import io
import shutil
from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import polars as pl

from roadperc_stream.cli import convert
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.output.tables import sidecar_path
from tests.accuracy.drives import Drive, make_logs
from tests.accuracy.scenarios import Scenario
from tests.accuracy.values import Tables


@dataclass(frozen=True)
class Results:
    """The tables of frames as files of each scenario by name and seed, and the errors of the others."""

    paths: Mapping[str, Mapping[int, Path]]
    failures: Mapping[str, str]

    def of(self, scenarios):
        """The tables of several scenarios' replays, in their order and that of the seeds.

        Raises:
            LookupError: a scenario has no replay; the message gives the reason.
        """
        for scenario in scenarios:
            if scenario.name not in self.paths:
                raise LookupError(self.failures.get(scenario.name, "not run"))
        runs = [(seed, path) for scenario in scenarios for seed, path in sorted(self.paths[scenario.name].items())]
        paths = [path for _, path in runs]
        tables = []
        for kind in (paths, [Path(str(path).replace(".metrics.", ".objects.")) for path in paths]):
            read = [
                pl.read_parquet(path).with_columns(replay=pl.lit(number), seed=pl.lit(seed))
                for number, ((seed, _), path) in enumerate(zip(runs, kind, strict=True))
            ]
            tables.append(pl.concat(read))
        return Tables(*tables, tuple(paths))

    def about(self, figures):
        """A sentence with the seeds and the number of frames of some figures."""
        scenarios = {scenario for figure in figures for scenario in figure.scenarios if scenario.name in self.paths}
        if not scenarios:
            return "No frames replayed."
        seeds = sorted({seed for scenario in scenarios for seed in self.paths[scenario.name]})
        return f"Seeds {seeds[0]} to {seeds[-1]}, {self.of(scenarios).frames.height} frames replayed."


def seeds_of(source, first, count):
    """The seeds of a drive, if ``count`` is the usual number; a recording has one."""
    return range(first, first + max(round(count * source.seeds), 1)) if isinstance(source, Drive) else (first,)


def run(scenarios, folder, *, first, count, jobs, said):
    """Replay scenarios in processes.

    Args:
        scenarios: the scenarios.
        folder: for tables and for rendered logs, which later runs reuse.
        first: the first seed.
        count: the usual number of seeds.
        jobs: number of processes.
        said: called with a line of text after each drive.
    """
    by_source = defaultdict(list)
    for scenario in scenarios:
        by_source[scenario.source].append(scenario)
    paths, failures = defaultdict(dict), {}
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        waiting = {
            pool.submit(replay_source, source, seed, wanted, folder): (wanted, seed)
            for source, wanted in by_source.items()
            for seed in seeds_of(source, first, count)
        }
        for number, done in enumerate(as_completed(waiting), 1):
            wanted, seed = waiting[done]
            problems = done.result()
            failures |= problems
            for scenario in wanted:
                if scenario.name not in problems:
                    paths[scenario.name][seed] = sidecar_path(target_of(scenario, seed, folder), "metrics")
            said(f"{number} of {len(waiting)}: {', '.join(scenario.name for scenario in wanted)}, seed {seed}")
    return Results(paths, failures)


def target_of(scenario, seed, folder):
    """The path of a scenario's replay."""
    return folder / "replays" / f"{scenario.name.replace(' ', '').replace('%', '')}-{seed}.mcap"


def replay_source(source, seed, scenarios: Sequence[Scenario], folder):
    """Replay all scenarios of one drive; returns the errors by scenario name."""
    try:
        if isinstance(source, Drive):
            logs = make_logs(folder, source, seed, {scenario.noise for scenario in scenarios})
        else:
            logs = dict.fromkeys((scenario.noise for scenario in scenarios), recording(source, folder))
    except (LookupError, RuntimeError) as error:
        return {scenario.name: str(error) for scenario in scenarios}
    problems = {scenario.name: replay(scenario, logs[scenario.noise], seed, folder) for scenario in scenarios}
    return {name: problem for name, problem in problems.items() if problem}


def recording(source, folder):
    """A recording, or what is written from one, as a log.

    Raises:
        LookupError: it does not exist.
        RuntimeError: it cannot be converted.
    """
    path, options = Path(source if isinstance(source, str) else source.folder), ()
    if not path.exists():
        raise LookupError(f"no recording {path.name}")
    if path.is_file():
        return path
    dump = folder / path.name
    if not isinstance(source, str):
        path = dump = folder / source.name
        options = source.write(dump)
    if convert.main([str(path), f"{dump}.mcap", "--quiet", "--force", *options]) != 0:
        raise RuntimeError(f"{dump.name} cannot be converted")
    return Path(f"{dump}.mcap")


def replay(scenario, log, seed, folder):
    """Replay a log and keep only the tables; returns an error line, or an empty text."""
    target = target_of(scenario, seed, folder)
    target.parent.mkdir(parents=True, exist_ok=True)
    options = ["--quiet", "--force", "--results-only"]
    options += ["--only", scenario.only] if scenario.only else []
    options += [word for setting in scenario.settings for word in ("--set", setting)]
    options += ["--template", scenario.template] if scenario.template else []
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors):
        code = replay_main([str(log), str(target), *options])
    target.unlink(missing_ok=True)
    lines = errors.getvalue().strip().splitlines()
    return "" if code == 0 else (lines[-1] if lines else f"exit code {code}")


def remove_replays(folder):
    """Remove the tables of earlier runs."""
    shutil.rmtree(folder / "replays", ignore_errors=True)
