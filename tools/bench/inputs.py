"""The logs of the benchmark: one scenario, rendered as PNG, as JPEG, with a stereo pair, and with ground truth."""

import argparse
import hashlib
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from roadperc_stream.cli.convert import main as convert
from roadperc_stream.cli.values import whole_number
from roadperc_stream.errors import DumpError
from roadperc_stream.log import LogSummary, LogWriter, read, summarise
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.text import print_line

from ..scene.job import render_and_report
from ..scene.options import RenderOptions

TRUTH: Final = "/truth/"
PAIR: Final = "/camera/right/"
LEFT_OUT: Final = {"png": (TRUTH, PAIR), "truth": (PAIR,), "jpeg": (TRUTH, PAIR), "stereo": (TRUTH,)}
"""The logs, and the prefixes of topics that each log lacks."""
JPEG: Final = ("jpeg", "stereo")
"""Logs with JPEG images; the others have PNG images."""
WARM_UP: Final = 3
"""Frames of a replay's start: afterwards all libraries are loaded, and tracks and motion have begun."""
_MADE_BY: Final = "made_by.txt"
_RATE_HZ: Final = 20.0


@dataclass(frozen=True)
class BenchLog:
    """A log to replay, a log of its first frames, whose time is the start, and a log of its first frame."""

    name: str
    path: Path
    warm_up: Path
    first_frame: Path
    frames: int


def bench_options(frames: int, size: tuple[int, int]) -> RenderOptions:
    """Return the benchmark's scenario: a bend of 150 m radius with cars; the ego car weaves in its lane."""
    return RenderOptions(*size, seconds=frames / _RATE_HZ, rate_hz=_RATE_HZ, scene="bend", weave_m=0.5)


def prepared(folder: Path, options: RenderOptions) -> dict[str, BenchLog]:
    """Return the logs by name; render them again if the options or the renderer have changed.

    Raises:
        RoadpercError: a log cannot be made.
    """
    made_by, kept = _digest(options), folder / _MADE_BY
    logs = {name: BenchLog(name, *_paths(folder, name), options.frames) for name in LEFT_OUT}
    if not kept.exists() or kept.read_text() != made_by:
        kept.unlink(missing_ok=True)
        for jpeg in (False, True):
            _make(folder, replace(options, jpeg=jpeg), [log for log in logs.values() if (log.name in JPEG) == jpeg])
        kept.write_text(made_by)
    return logs


def _paths(folder: Path, name: str) -> tuple[Path, Path, Path]:
    return folder / f"{name}.mcap", folder / f"{name}-warm-up.mcap", folder / f"{name}-first-frame.mcap"


def _digest(options: RenderOptions) -> str:
    """Return a digest of the options, and of the code of renderer, converter and this module."""
    digest = hashlib.sha256(repr(options).encode())
    tools = Path(__file__).parents[1]
    sources = [path for path in tools.rglob("*.py") if path.relative_to(tools).parts[0] != "bench"]
    for path in (*sorted(sources), Path(__file__)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _make(folder: Path, options: RenderOptions, logs: list[BenchLog]) -> None:
    dump, whole = folder / "dump", folder / "whole.mcap"
    print_line(f"rendering {options.frames} frames with {'JPEG' if options.jpeg else 'PNG'} images")
    render_and_report(dump, options, force=True)
    if convert([str(dump), str(whole), "--force", "--quiet"]):
        raise DumpError(f"{dump}: the conversion failed")
    summary = summarise(whole)
    for log in logs:
        for path, frames in ((log.path, options.frames), (log.warm_up, WARM_UP), (log.first_frame, 1)):
            _write_first_frames(summary, path, LEFT_OUT[log.name], frames)
    whole.unlink()
    shutil.rmtree(dump)


def _write_first_frames(summary: LogSummary, target: Path, left_out: tuple[str, ...], frames: int) -> None:
    """Write the first frames of a log, without topics that start with one of the prefixes ``left_out``."""
    images, last_ns = 0, 0
    with LogWriter(target) as writer:
        for message in read(summary):
            if images == frames and message.log_time_ns > last_ns:
                break
            if message.channel.topic == ROLES["image"].topic:  # it starts a frame
                images, last_ns = images + 1, message.log_time_ns
            if not message.channel.topic.startswith(left_out):
                writer.write(message)
        for metadata in summary.metadata:
            writer.describe(metadata)


def add_input_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for folder and size of the logs."""
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="folder that keeps the rendered logs")
    parser.add_argument("--frames", type=whole_number, default=60, metavar="N", help="frames of each log (60)")
    parser.add_argument(
        "--width", type=whole_number, default=1280, metavar="PX", help="width of the images, 4:3 (1280)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the results to a file")


def logs_of(arguments: argparse.Namespace) -> dict[str, BenchLog]:
    """Return the logs of the arguments; render them if needed."""
    arguments.folder.mkdir(parents=True, exist_ok=True)
    frames, size = max(arguments.frames, WARM_UP + 1), (arguments.width, arguments.width * 3 // 4)
    return prepared(arguments.folder, bench_options(frames, size))
