"""How long each stage takes, in units of decoding one of the log's own camera images in the same run.

Seconds change with the machine and its load; what a stage costs beside a decode that everybody knows changes little.
Run it with ``make bench`` or ``python -m roadperc_stream.tools.bench.stages LOG.mcap``.
"""

import argparse
import sys
from pathlib import Path
from statistics import median
from time import perf_counter

from rich.console import Console
from rich.table import Table

from roadperc_stream.chain.step import ChainState, step
from roadperc_stream.cli.plumbing import run
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Sample
from roadperc_stream.core.stage_timer import StageTimer
from roadperc_stream.core.threads import one_thread
from roadperc_stream.core.time import TimeRange
from roadperc_stream.errors import LogError
from roadperc_stream.input import ReplaySource, open_input

WARM_UP = 3


def main(argv: list[str] | None = None) -> int:
    """Measure a log's stages and print them."""
    parser = argparse.ArgumentParser(prog="python -m roadperc_stream.tools.bench.stages", description=__doc__)
    parser.add_argument("log", metavar="LOG.mcap", type=Path)
    parser.add_argument("--frames", type=int, default=40, metavar="N", help="frames measured (40)")
    arguments = parser.parse_args(argv)
    return run(lambda: print_stages(measure(arguments.log, arguments.frames)))


def measure(path: Path, frames: int) -> dict[str, float]:
    """Median milliseconds of each stage and of decoding the camera image, over the frames behind the warm-up.

    Raises:
        RoadpercError: the log cannot be replayed, or holds too few frames.
    """
    cfg, times = ReplayConfig(), dict[str, list[float]]()
    part = TimeRange(frames=frames + WARM_UP)
    state = ChainState()
    with one_thread():
        for sample in open_input(ReplaySource(path, time_range=part), cfg).samples():
            timer = StageTimer()
            state, _ = step(cfg, state, sample.frame, timer)
            readings = timer.elapsed_ms | {"camera image": _decode_ms(sample)}
            if sample.index >= WARM_UP:
                for name, value in readings.items():
                    times.setdefault(name, []).append(value)
    if not times:
        raise LogError(f"{path}: expected more than {WARM_UP} frames")
    return {name: median(values) for name, values in times.items()}


def print_stages(times_ms: dict[str, float]) -> None:
    """A row per stage: milliseconds, and how many decodes of the camera image that is."""
    unit = times_ms.pop("camera image")
    table = Table("stage", "median ms", "camera images", title="time of each stage")
    for name, value in (*times_ms.items(), ("together", sum(times_ms.values())), ("camera image", unit)):
        table.add_row(name, f"{value:.2f}", f"{value / unit:.2f}")
    Console().print(table)


def _decode_ms(sample: Sample) -> float:
    if sample.frame.image is None:
        raise LogError(f"frame {sample.index}: no camera image to measure against")
    started = perf_counter()
    sample.frame.image.decode_bgr()
    return (perf_counter() - started) * 1000


if __name__ == "__main__":
    sys.exit(main())
