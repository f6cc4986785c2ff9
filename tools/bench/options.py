"""What the bench's programs have in common on their command lines."""

import argparse
from pathlib import Path

from roadperc_stream.cli.plumbing import whole_number

from .inputs import WARM_UP, BenchLog, drive, prepared


def add_input_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the logs are, and how large."""
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="gets the rendered logs, and keeps them")
    parser.add_argument("--frames", type=whole_number, default=60, metavar="N", help="of each log (60)")
    parser.add_argument("--width", type=whole_number, default=1280, metavar="PX", help="of the images, 4:3 (1280)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all of it to a file, too")


def logs_of(arguments: argparse.Namespace) -> dict[str, BenchLog]:
    """The logs that the arguments ask for, rendered if need be."""
    arguments.folder.mkdir(parents=True, exist_ok=True)
    frames, size = max(arguments.frames, WARM_UP + 1), (arguments.width, arguments.width * 3 // 4)
    return prepared(arguments.folder, drive(frames, size))
