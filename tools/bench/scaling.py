"""Where a batch stops scaling: 10 to 1000 workers over thousands of logs, simulated with what was measured.

Run it with ``make bench-scaling`` or ``python -m roadperc_stream.tools.bench.scaling``. Lengths of logs and costs are
those of a list of runs where one is given; the driver's time for a log, and polars' for a file, are measured first.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Final

from roadperc_stream.cli.plumbing import positive_seconds, run, whole_number
from roadperc_stream.core.text import print_line
from roadperc_stream.output.text_table import TextTable, row

from .fleet import FleetCosts, FleetRun, FleetSplit, simulate
from .fleet_costs import driver_s, measured, quantiles, scan_s, usual_lengths
from .printing import print_tables

_WORKERS: Final = (10, 30, 100, 300, 1000)
_MEASURED_LOGS: Final = 2000
_MEASURED_FILES: Final = 200
_MEASURED_ROWS: Final = 500
_MEASURED_SLOTS: Final = 100
_H: Final = 3600.0
_COSTS: Final = {
    "frames_per_s": ("frames a second of a log", "N"),
    "frame_s": ("a processor's time for a frame", "S"),
    "cut_s": ("a processor's time for a frame where a log is cut into parts", "S"),
    "start_s": ("a worker's time for a log, fetching and frames apart", "S"),
    "frame_bytes": ("size of a frame in the log", "B"),
    "result_bytes": ("size of a frame in the tables", "B"),
    "store_bytes_per_s": ("what the store gives and takes a second", "B"),
    "worker_bytes_per_s": ("what a worker gets of that at most", "B"),
    "driver_s": ("the driver's time for a log", "S"),
}
"""What each of ``FleetCosts`` is, and in what it counts."""
_UNITS: Final = {"N": "frames", "S": "s", "B": "bytes"}


def main(argv: list[str] | None = None) -> int:
    """Measure, simulate and print."""
    arguments = _parser().parse_args(argv)
    return run(lambda: _bench(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m roadperc_stream.tools.bench.scaling", description=__doc__)
    add = parser.add_argument
    add("--runs", type=Path, metavar="FILE", help="a dataset's runs.parquet: lengths and costs are drawn from it")
    add("--logs", type=whole_number, default=10_000, metavar="N", help="how many logs (10000)")
    add("--workers", type=whole_number, nargs="+", default=_WORKERS, metavar="N", help="how many workers (10 to 1000)")
    add("--seed", type=int, default=1, metavar="N", help="of the logs' lengths (1)")
    add("--split", type=positive_seconds, metavar="S", help="logs are replayed in parts of so many seconds")
    add("--warm-up", type=float, default=5.0, metavar="S", help="with --split: what each part sees before (5)")
    for name, (words, unit) in _COSTS.items():
        default = f"{getattr(FleetCosts, name):g}" if name != "driver_s" else "as measured here"
        add(f"--{name.replace('_', '-')}", type=float, metavar=unit, help=f"{words} ({default})")
    return parser


def _bench(arguments: argparse.Namespace) -> None:
    costs = FleetCosts()
    if arguments.runs:
        lengths_s, costs = measured(arguments.runs, arguments.logs, arguments.seed, costs)
    else:
        lengths_s = usual_lengths(arguments.logs, arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        scanned_s = scan_s(_MEASURED_FILES, _MEASURED_ROWS, Path(folder))
    if arguments.driver_s is None:
        with tempfile.TemporaryDirectory() as folder:
            costs = replace(costs, driver_s=driver_s(_MEASURED_LOGS, _MEASURED_SLOTS, Path(folder)))
    given = {field.name: getattr(arguments, field.name) for field in fields(FleetCosts)}
    costs = replace(costs, **{name: value for name, value in given.items() if value is not None})
    split = FleetSplit(arguments.split, arguments.warm_up) if arguments.split else None
    found = [simulate(lengths_s, workers, costs, split) for workers in arguments.workers]
    _print(lengths_s, costs, found, scanned_s)


def _print(lengths_s: Sequence[float], costs: FleetCosts, found: Sequence[FleetRun], scanned_s: float) -> None:
    half, most, longest = quantiles(lengths_s)
    hours = sum(lengths_s) / _H
    spread = f"median {half:.0f} s, 99 % below {most:.0f} s, at most {longest:.0f} s"
    print_line(f"{len(lengths_s)} logs, {hours:.0f} h: {spread}")
    for name, (words, unit) in _COSTS.items():
        print_line(f"{words}: {getattr(costs, name):.4g} {_UNITS[unit]}")
    print_line(f"CPU s an hour of log {_H * costs.frames_per_s * costs.frame_s:.0f}")
    print_tables([fleet_table(found)])
    logs = len(lengths_s)
    print_line(
        f"{logs} tables of metrics at the end: {1000 * scanned_s:.2f} ms a file, {logs * scanned_s:.1f} s for polars"
    )


def fleet_table(found: Sequence[FleetRun]) -> TextTable:
    """A row for each number of workers."""
    rows = (
        row(
            str(run.workers),
            f"{run.seconds / _H:.2f}",
            f"{run.speed:.0f}",
            f"{100 * run.efficiency:.0f}",
            run.bottleneck,
        )
        for run in found
    )
    headers = ("hours", "h of log an hour", "efficiency %", "bottleneck")
    return TextTable("workers", headers, tuple(rows), last_is_text=True)


if __name__ == "__main__":
    sys.exit(main())
