"""Measure the speed of replays against the course method, and the time of each part.

Run ``make bench`` or ``python -m roadperc_stream.tools.bench FOLDER``. The input is rendered into the folder once.
Each run is a separate process. In each round all jobs run once.
"""

import argparse
import json
import os
import sys
from functools import partial
from pathlib import Path

from roadperc_stream.cli.launch import run
from roadperc_stream.cli.values import whole_number

from .figures import ALL, BARE, COMPARED, HELP, LOGS, ONE, Measure, measured, replay_name, tables, write_json
from .inputs import BenchLog, add_input_arguments, logs_of
from .replays import cost_of, replay_command, replay_cost, start_cost


def main(argv: list[str] | None = None) -> int:
    """Run the benchmark and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m roadperc_stream.tools.bench", description=__doc__)
    add_input_arguments(parser)
    parser.add_argument(
        "--course-frames", type=whole_number, default=10, metavar="N", help="frames for the course method (10)"
    )
    parser.add_argument("--rounds", type=whole_number, default=3, metavar="N", help="runs of each job (3)")
    arguments = parser.parse_args(argv)
    return run(lambda: _bench(arguments))


def _bench(arguments: argparse.Namespace) -> None:
    jobs = _jobs(arguments.folder, logs_of(arguments), arguments.course_frames)
    series = measured(jobs, arguments.rounds)
    print("\n".join(tables(series)))
    if arguments.json:
        write_json(arguments.json, series, {"frames": arguments.frames, "rounds": arguments.rounds})


def _jobs(folder: Path, logs: dict[str, BenchLog], course_frames: int) -> dict[str, Measure]:
    """Return the jobs by name; compared jobs follow each other."""
    jobs: dict[str, Measure] = {
        BARE: partial(start_cost, BARE, [sys.executable, "-P", "-c", BARE]),
        HELP: partial(start_cost, HELP, replay_command("--help")),
    }
    for name in LOGS:
        log, out = logs[name], folder / f"{name}-result.mcap"
        if name in COMPARED:
            jobs[f"course {name}"] = partial(_course_cost, log.path, course_frames)
        for threads, count in ((ONE, 1), (ALL, os.cpu_count() or 1)):
            job = replay_name(name, threads)
            jobs[job] = partial(replay_cost, job, log, out, count)
    return jobs


def _course_cost(log: Path, frames: int) -> dict[str, float]:
    """Run ``measure`` of the course method in a separate process and return its result."""
    out = log.with_name("measured.json")
    call = f"from {__package__}.course import measure; found = measure({str(log)!r}, {frames})"
    code = f"import json; {call}; open({str(out)!r}, 'w').write(json.dumps(found))"
    cost_of("course", [sys.executable, "-P", "-c", code])
    found: dict[str, float] = json.loads(out.read_text())
    return found


if __name__ == "__main__":
    sys.exit(main())
