"""How fast a replay is: beside the course's method, beside what it cannot avoid, and part by part.

Run it with ``make bench`` or ``python -m roadperc_stream.tools.bench FOLDER``. Its input is rendered into the folder
once. Every run is a process of its own; all of them take turns, round after round.
"""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Final

from roadperc_stream.cli.plumbing import run, whole_number
from roadperc_stream.system.cost import cost_of

from .agreement import require_agreement
from .figures import ALL, COMPARED, LOGS, ONE, BenchJob, course_name, figures, floor_name, measured, replay_name
from .inputs import BenchLog, add_input_arguments, logs_of
from .printing import print_tables, tables, write_json, write_page
from .replays import Installation, replay_job, start_jobs

_AGREEING_FRAMES: Final = 3


def main(argv: list[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m roadperc_stream.tools.bench", description=__doc__)
    add_input_arguments(parser)
    parser.add_argument(
        "--course-frames", type=whole_number, default=10, metavar="N", help="of the course's method (10)"
    )
    parser.add_argument("--rounds", type=whole_number, default=3, metavar="N", help="runs of each (3)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="put the tables in their place in a page of the docs")
    arguments = parser.parse_args(argv)
    return run(lambda: _bench(arguments))


def _bench(arguments: argparse.Namespace) -> None:
    logs = logs_of(arguments)
    for log in COMPARED:
        require_agreement(logs[log].path, _AGREEING_FRAMES)
    series = measured(_jobs(arguments.folder, logs, arguments.course_frames), arguments.rounds)
    found = figures(series)
    printed = tables(series, found)
    print_tables(printed)
    if arguments.page:
        write_page(arguments.page, printed)
    if arguments.json:
        write_json(arguments.json, series, found, {"frames": arguments.frames, "rounds": arguments.rounds})


def _jobs(folder: Path, logs: dict[str, BenchLog], course_frames: int) -> list[BenchJob]:
    """In an order that puts beside each other what is compared; the floor needs a replay's results."""
    here, processors = Installation.of(Path(sys.executable)), os.cpu_count() or 1
    jobs = start_jobs(here)
    for name in LOGS:
        log, out = logs[name], folder / f"{name}-result.mcap"
        if name in COMPARED:
            jobs += [_course_job(log, course_frames), _course_job(log, course_frames, all_threads=True)]
        jobs.append(replay_job(replay_name(name, ONE), here, log, out, 1))
        if here.takes_threads:
            jobs.append(replay_job(replay_name(name, ALL), here, log, out, processors))
        if name in COMPARED:
            jobs.append(_child_job(floor_name(name), folder, "floor", str(log.path), str(out), at=2))
    return jobs


def _course_job(log: BenchLog, frames: int, *, all_threads: bool = False) -> BenchJob:
    name = f"{course_name(log.name)}, {ALL}" if all_threads else course_name(log.name)
    options = ["--all-threads"] if all_threads else []
    return _child_job(name, log.path.parent, "course", str(log.path), "--frames", str(frames), *options, at=1)


def _child_job(name: str, folder: Path, module: str, *arguments: str, at: int) -> BenchJob:
    """The job of a module of this folder that writes what it measures to a file, its argument in a place."""
    out = folder / "measured.json"
    words = [
        sys.executable,
        "-P",
        "-m",
        f"roadperc_stream.tools.bench.{module}",
        *arguments[:at],
        str(out),
        *arguments[at:],
    ]

    def measure() -> dict[str, float]:
        cost_of(name, words)
        found: dict[str, float] = json.loads(out.read_text())
        return found

    return BenchJob(name, measure)


if __name__ == "__main__":
    sys.exit(main())
