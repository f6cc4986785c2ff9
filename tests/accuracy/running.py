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
from tests import course
from tests.accuracy.drives import Drive, Excerpt, make_logs
from tests.accuracy.scenarios import Scenario


@dataclass(frozen=True)
class Replayed:
    """The tables of one replay: a row per frame, and a row per detection."""

    scenario: str
    seed: int
    path: Path
    frames: pl.DataFrame
    objects: pl.DataFrame


@dataclass(frozen=True)
class Results:
    """The replays of each scenario by name, and the errors of the others."""

    replays: Mapping[str, Sequence[Replayed]]
    failures: Mapping[str, str]

    def of(self, scenarios):
        """The replays of several scenarios.

        Raises:
            LookupError: a scenario has no replay; the message gives the reason.
        """
        for scenario in scenarios:
            if scenario.name not in self.replays:
                raise LookupError(self.failures.get(scenario.name, "not run"))
        return [replay for scenario in scenarios for replay in self.replays[scenario.name]]


def seeds_of(source, first, count):
    """The seeds of a drive, if ``count`` is the usual number; a recording has one."""
    return range(first, first + max(round(count * source.seeds), 1)) if isinstance(source, Drive) else (first,)


def run(scenarios, folder, *, first, count, jobs, said):
    """Replay scenarios in processes; ``said`` is called after each drive.

    Args:
        scenarios: the scenarios.
        folder: for tables and for rendered logs, which later runs reuse.
        first: the first seed.
        count: the usual number of seeds.
        jobs: number of processes.
        said: called with a line of text.
    """
    by_source = defaultdict(list)
    for scenario in scenarios:
        by_source[scenario.source].append(scenario)
    replays, failures = defaultdict(list), {}
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        waiting = {
            pool.submit(replay_source, source, seed, tuple(wanted), folder): (wanted, seed)
            for source, wanted in by_source.items()
            for seed in seeds_of(source, first, count)
        }
        for number, done in enumerate(as_completed(waiting), 1):
            wanted, seed = waiting[done]
            problems = done.result()
            failures |= problems
            for scenario in wanted:
                if scenario.name not in problems:
                    replays[scenario.name].append(load(scenario, seed, folder))
            said(f"{number} of {len(waiting)}: {', '.join(scenario.name for scenario in wanted)}, seed {seed}")
    return Results(replays, failures)


def target_of(scenario, seed, folder):
    """The path of a scenario's replay."""
    return folder / "replays" / f"{scenario.name.replace(' ', '').replace('%', '')}-{seed}.mcap"


def load(scenario, seed, folder):
    """The tables of a scenario's replay."""
    target = target_of(scenario, seed, folder)
    path = sidecar_path(target, "metrics")
    return Replayed(scenario.name, seed, path, pl.read_parquet(path), pl.read_parquet(sidecar_path(target, "objects")))


def replay_source(source, seed, scenarios: Sequence[Scenario], folder):
    """Replay all scenarios of one drive; returns the errors by scenario name."""
    try:
        if isinstance(source, Drive):
            logs = make_logs(folder, source, seed, {scenario.noise for scenario in scenarios})
        else:
            made = excerpt(source, folder) if isinstance(source, Excerpt) else recording(Path(source), folder)
            logs = {scenario.noise: made for scenario in scenarios}
    except (LookupError, RuntimeError) as error:
        return {scenario.name: str(error) for scenario in scenarios}
    problems = {scenario.name: replay(scenario, logs[scenario.noise], seed, folder) for scenario in scenarios}
    return {name: problem for name, problem in problems.items() if problem}


def recording(source, folder):
    """A recording as a log.

    Raises:
        LookupError: it does not exist.
        RuntimeError: it cannot be converted.
    """
    if not source.exists():
        raise LookupError(f"no recording {source.name}")
    if source.is_file():
        return source
    target = folder / f"{source.name}.mcap"
    if (source / "left.png").exists():
        course.write_dump(source, folder / f"{source.name}-dump")
        source = folder / f"{source.name}-dump"
    if convert.main([str(source), str(target), "--quiet", "--force"]) != 0:
        raise RuntimeError(f"{source.name} cannot be converted")
    return target


def excerpt(source, folder):
    """Frames of a recording as a log.

    Raises:
        LookupError: it does not exist.
        RuntimeError: it cannot be converted.
    """
    if not Path(source.folder).exists():
        raise LookupError(f"no recording {Path(source.folder).name}")
    dump = folder / f"{Path(source.folder).name}-{source.step}"
    rate_hz = source.write(dump)
    if convert.main([str(dump), f"{dump}.mcap", "--quiet", "--force", "--rate", f"{rate_hz:g}"]) != 0:
        raise RuntimeError(f"{dump.name} cannot be converted")
    return Path(f"{dump}.mcap")


def replay(scenario, log, seed, folder):
    """Replay a log and keep only the tables; returns an error line, or an empty text."""
    target = target_of(scenario, seed, folder)
    target.parent.mkdir(parents=True, exist_ok=True)
    stages = ["--only", scenario.only] if scenario.only else []
    settings = [part for setting in scenario.settings for part in ("--set", setting)]
    errors = io.StringIO()
    template = ["--template", scenario.template] if scenario.template else []
    options = ["--quiet", "--force", "--results-only", *stages, *settings, *template]
    with contextlib.redirect_stderr(errors):
        code = replay_main([str(log), str(target), *options])
    target.unlink(missing_ok=True)
    lines = errors.getvalue().strip().splitlines()
    return "" if code == 0 else (lines[-1] if lines else f"exit code {code}")


def remove_replays(folder):
    """Remove the tables of earlier runs."""
    shutil.rmtree(folder / "replays", ignore_errors=True)
