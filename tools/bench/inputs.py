"""The bench's own logs: one drive, rendered once, as PNG and as JPEG, with a stereo pair, and with truth."""

import argparse
import hashlib
import shutil
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from roadperc_stream.cli.convert import main as convert
from roadperc_stream.cli.plumbing import whole_number
from roadperc_stream.errors import DumpError
from roadperc_stream.log import LogSummary, LogWriter, Message, summarise
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.text import print_line

from ..scene.job import render_and_report
from ..scene.options import RenderOptions

TRUTH: Final = "/truth/"
PAIR: Final = "/camera/right/"
LEFT_OUT: Final = {"png": (TRUTH, PAIR), "truth": (PAIR,), "jpeg": (TRUTH, PAIR), "stereo": (TRUTH,)}
"""The logs, and how the topics begin that each of them lacks."""
JPEG: Final = ("jpeg", "stereo")
"""Logs whose camera images are JPEG; those of the others are PNG."""
WARM_UP: Final = 3
"""Frames that are part of a replay's start: what is loaded late is loaded by then, tracks and motion have begun."""
_MADE_BY: Final = "made_by.txt"
_RATE_HZ: Final = 20.0


@dataclass(frozen=True)
class BenchLog:
    """A log to replay, its first frames as one, and the very first: what they take is the start."""

    name: str
    path: Path
    warm_up: Path
    first_frame: Path
    frames: int


def drive(frames: int, size: tuple[int, int]) -> RenderOptions:
    """The drive of the bench: a bend of 150 m radius with cars, the ego car weaving in its lane."""
    return RenderOptions(*size, seconds=frames / _RATE_HZ, rate_hz=_RATE_HZ, scene="bend", weave_m=0.5)


def prepared(folder: Path, options: RenderOptions) -> dict[str, BenchLog]:
    """The logs by name, rendered again where anything that makes them has changed.

    Raises:
        RoadpercError: they cannot be made.
    """
    made_by = _digest(options)
    kept = folder / _MADE_BY
    if not kept.exists() or kept.read_text() != made_by:
        kept.unlink(missing_ok=True)
        for path in folder.glob("*.mcap"):
            path.unlink()
        _make(folder, options)
        kept.write_text(made_by)
    return {name: BenchLog(name, *_paths(folder, name), options.frames) for name in LEFT_OUT}


def _paths(folder: Path, name: str) -> tuple[Path, Path, Path]:
    return folder / f"{name}.mcap", folder / f"{name}-warm-up.mcap", folder / f"{name}-first-frame.mcap"


def _digest(options: RenderOptions) -> str:
    """Of the options, and of the code of the renderer, the converter and this module."""
    digest = hashlib.sha256(repr(options).encode())
    tools = Path(__file__).parents[1]
    sources = [path for path in tools.rglob("*.py") if path.relative_to(tools).parts[0] != "bench"]
    for path in (*sorted(sources), Path(__file__)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _make(folder: Path, options: RenderOptions) -> None:
    for kind, names in (("png", ("png", "truth")), ("jpeg", JPEG)):
        dump, whole = folder / f"{kind}-dump", folder / f"{kind}-whole.mcap"
        print_line(f"rendering {options.frames} frames with {kind.upper()} images")
        render_and_report(dump, replace(options, jpeg=kind == "jpeg"), force=True)
        if convert([str(dump), str(whole), "--force", "--quiet"]):
            raise DumpError(f"{dump}: cannot be converted")
        summary = summarise(whole)
        for name in names:
            for path, frames in zip(_paths(folder, name), (options.frames, WARM_UP, 1), strict=True):
                write_part(summary, path, LEFT_OUT[name], frames)
        whole.unlink()
        shutil.rmtree(dump)


def write_part(summary: LogSummary, target: Path, left_out: Collection[str], frames: int) -> None:
    """Write a log's first frames, without the topics that begin with one of the texts left out."""
    with LogWriter(target) as writer:
        for message in of_frames(summary, frames):
            if not message.channel.topic.startswith(tuple(left_out)):
                writer.write(message)
        for record in summary.metadata:
            writer.describe(record)


def of_frames(summary: LogSummary, count: int) -> Iterator[Message]:
    """The messages of a log's first frames, by the images of its front camera."""
    images, last_ns = 0, 0
    for message in summary.source.messages(None, None, None):
        if images == count and message.log_time_ns > last_ns:
            return
        if message.channel.topic == ROLES["image"].topic:
            images, last_ns = images + 1, message.log_time_ns
        yield message


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
