"""What may not grow with the log: memory over 100 and 3000 frames, and encoding over frames 0 to 100 and 900 to 1000.

Run it with ``make bench-long`` or ``python -m roadperc_stream.tools.bench.long FOLDER``. The log is that of the bench
with a stereo pair, its frames forwards and backwards in turn.
"""

import argparse
import sys
from pathlib import Path
from typing import Final

from roadperc_stream.api import read_metrics
from roadperc_stream.cli.plumbing import run, whole_number
from roadperc_stream.core.cost import Cost, cost_of
from roadperc_stream.core.text import print_line

from .figures import SpeedFigure
from .inputs import BenchLog
from .long_log import write_long
from .options import add_input_arguments, logs_of
from .printing import figures_table, print_tables, write_json
from .replays import Installation

_SHORT: Final = 100
_WINDOW: Final = 100
_LATE: Final = 900
"""Frames of the short log, frames over which encoding is averaged, and where they begin late in the log."""


def main(argv: list[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m roadperc_stream.tools.bench.long", description=__doc__)
    add_input_arguments(parser)
    parser.add_argument("--long-frames", type=whole_number, default=3000, metavar="N", help="of the long log (3000)")
    arguments = parser.parse_args(argv)
    return run(lambda: _bench(arguments))


def _bench(arguments: argparse.Namespace) -> None:
    source, lengths = logs_of(arguments)["stereo"], (min(_SHORT, arguments.long_frames), arguments.long_frames)
    costs = {frames: _replayed(arguments.folder, source, frames) for frames in dict.fromkeys(lengths)}
    rows = read_metrics(_result(arguments.folder))
    found = long_figures(costs[lengths[0]], costs[lengths[1]], rows["encode_ms"].to_list())
    print_tables([figures_table(found)])
    for frames, cost in costs.items():
        print_line(f"{frames} frames: {cost.peak_mb:.0f} MB, {cost.cpu_s:.0f} s of processors, {cost.wall_s:.0f} s")
    if arguments.json:
        write_json(arguments.json, {}, found, {"frames": lengths[1]})


def _result(folder: Path) -> Path:
    return folder / "long-result.mcap"


def _replayed(folder: Path, source: BenchLog, frames: int) -> Cost:
    """What replaying a log of so many frames takes; the log is removed, the result kept for the tables beside it."""
    log, here = folder / "long.mcap", Installation.of(Path(sys.executable))
    print_line(f"replaying {frames} frames")
    try:
        write_long(source.path, log, frames)
        words = here.replay(log, _result(folder), *here.threads(1), "--force", "--quiet")
        return cost_of(f"replay of {frames} frames", words)
    finally:
        log.unlink(missing_ok=True)


def long_figures(short: Cost, long: Cost, encode_ms: list[float]) -> list[SpeedFigure]:
    """What is wanted of a long log, and what was measured.

    Args:
        short: of the short log.
        long: of the long one.
        encode_ms: of each frame of the long one; compared where there are enough.
    """
    found = [
        SpeedFigure("memory over the long log, of that over the short one", long.peak_mb / short.peak_mb, most=1.05),
        SpeedFigure("peak memory with stereo, MB", long.peak_mb, most=500.0),
    ]
    if len(encode_ms) < _LATE + _WINDOW:
        return found
    early, late = (sum(encode_ms[at : at + _WINDOW]) for at in (0, _LATE))
    return [*found, SpeedFigure("encoding late in the log, of that early in it", late / early, most=1.1)]


if __name__ == "__main__":
    sys.exit(main())
