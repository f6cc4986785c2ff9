"""One pass over a log beside its parts joined, for several splits and warm-ups: tables that are kept in a folder."""

import os
import shutil
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Final

from roadperc_stream.batch.joining import join
from roadperc_stream.batch.part_replay import read_part, replay_part
from roadperc_stream.batch.splitting import SplitPart, parts_of_log
from roadperc_stream.cli.convert import main as convert
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.text import print_line
from roadperc_stream.errors import DumpError
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.log import summarise
from roadperc_stream.output.tables import sidecar_path, write_table

from ..render_scene import render
from ..scene.options import RenderOptions
from .inputs import write_part

_UNUSED: Final = ("/truth/lanes", "/truth/surface", "/truth/objects", "/truth/segmentation", "/truth/depth")
_DEPTH: Final = "/camera/front/depth"
_PAIR: Final = "/camera/right/"
LEFT_OUT: Final = {
    "depth": (*_UNUSED, _PAIR),
    "stereo": (*_UNUSED, _DEPTH),
    "mono": (*_UNUSED, _DEPTH, _PAIR),
}
"""The sensors beside the front camera, and how the topics begin that a log with those lacks."""


@dataclass(frozen=True)
class SplitRun:
    """A log, how it is split, and the tables that come of it; without a split it is one pass."""

    sensors: str
    seed: int
    split_s: float | None = None
    warm_up_s: float = 0.0

    def log(self, folder: Path) -> Path:
        """The log in the bench's folder."""
        return folder / f"{self.sensors}-{self.seed}.mcap"

    def result(self, folder: Path) -> Path:
        """What its tables' names are made from."""
        kind = "whole" if self.split_s is None else f"{self.split_s:g}-{self.warm_up_s:g}"
        return folder / f"{self.sensors}-{self.seed}-{kind}.mcap"

    def table(self, folder: Path, name: str) -> Path:
        """One of its tables."""
        return sidecar_path(self.result(folder), name)

    @property
    def one_pass(self) -> "SplitRun":
        """The same log in one pass."""
        return SplitRun(self.sensors, self.seed)


def runs_of(seeds: Sequence[int], splits_s: Sequence[float], warm_ups_s: Sequence[float]) -> list[SplitRun]:
    """All runs with a split; those of one log and split together."""
    return [SplitRun(*options) for options in product(LEFT_OUT, seeds, splits_s, warm_ups_s)]


def make_logs(folder: Path, seed: int, seconds: float, width: int) -> None:
    """Render a drive through town with a change of lane, and write its logs, where they are not there yet.

    Raises:
        RoadpercError: they cannot be made.
    """
    missing = [sensors for sensors in LEFT_OUT if not SplitRun(sensors, seed).log(folder).exists()]
    if not missing:
        return
    dump, whole = folder / f"dump-{seed}", folder / f"all-{seed}.mcap"
    print_line(f"rendering {seconds:g} s with seed {seed}")
    options = RenderOptions(width, width * 3 // 4, seconds, 10.0, "town", seed=seed)
    options = replace(options, tag_noise=0.01, depth_noise=0.002, jpeg=True, change_lane="right")
    render(dump, options, force=True)
    if convert([str(dump), str(whole), "--force", "--quiet"]):
        raise DumpError(f"{dump}: cannot be converted")
    summary = summarise(whole)
    for sensors in missing:
        write_part(summary, SplitRun(sensors, seed).log(folder), LEFT_OUT[sensors], options.frames)
    whole.unlink()
    shutil.rmtree(dump)


def replay_all(folder: Path, runs: Iterable[SplitRun]) -> None:
    """Replay what is not there yet, on all cores.

    Raises:
        RoadpercError: a log cannot be replayed.
    """
    wanted = dict.fromkeys(run for split in runs for run in (split.one_pass, split))
    missing = [run for run in wanted if not run.table(folder, "objects").exists()]
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        for done in pool.map(partial(_replayed, folder), missing):
            print_line(f"replayed {done.name}")


def _replayed(folder: Path, run: SplitRun) -> Path:
    """The joined tables of a run."""
    cfg, source, result = ReplayConfig(), ReplaySource(run.log(folder)), run.result(folder)
    parts: tuple[SplitPart, ...] = (SplitPart(0, None, None),)
    log_in = open_input(source, cfg)
    if run.split_s is not None:
        parts = parts_of_log(log_in, cfg, run.split_s)
    tables = []
    for part in parts:
        target = result.with_stem(f"{result.stem}-part")
        replay_part(source, part, cfg, target, run.warm_up_s)
        tables.append(read_part(part, target))
        for file in (target, sidecar_path(target, "metrics"), sidecar_path(target, "objects")):
            file.unlink()
    joined = join(log_in.log_id, tables)
    write_table(run.table(folder, "metrics"), joined.metrics)
    write_table(run.table(folder, "objects"), joined.objects)
    return result
