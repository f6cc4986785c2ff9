"""``roadperc-lanes``: a run's lanes as TuSimple's JSON lines, and their score against true ones."""

import argparse
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final, get_args

from rich.table import Table

from roadperc_stream import __version__
from roadperc_stream.cli.plumbing import run
from roadperc_stream.cli.terminal import console_for, grid, print_lines

from .grid import percent
from .lane_files.recorded import RunLanes, default_rows, lane_frame, open_lanes
from .lane_files.scoring import FrameScore, LaneScores, Pairing, by_key, paired, score_frame, summed, unanswered
from .lane_files.tusimple import LaneFileError, LaneFrame, lane_writer, read_frames

NAMED: Final = 10
"""Missing frames that are named; of more the number is told."""
_DESCRIPTION = """\
Write the lanes a run saw as TuSimple's JSON lines, and score them against true ones in the same format.

Each boundary is the smoothed line in the image (line_px), at every tenth row from 160 to 710 of 720 or the same part
of another height; with --truth it is at the true frame's own h_samples and under its raw_file, and only frames that
have a truth are written. raw_file is LOG/STAMP_NS, and run_time the frame's total_ms from the table beside the log,
0 without one. A true frame belongs to the frame whose stamp ends its raw_file; --pair order takes them as they come.

Scores are TuSimple's (20 px over the cosine of the lane's angle, lanes found at 85 % of their points) and CULane's F1
(lines 30 px wide), with pixels scaled from the benchmarks' 1280 and 1640 columns to the image's. A true frame that the
run lacks scores as one in which it saw nothing. What the log itself carries as /truth/lanes the replay has scored
already: roadperc-report shows it.
"""
_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/sample.mcap
  roadperc-lanes runs/sample.mcap --tusimple sample.json                write what the run saw
  roadperc-replay logs/sample.mcap runs/other.mcap --set lanes.model=line
  roadperc-lanes runs/other.mcap --truth sample.json                    hold another run against it
  roadperc-lanes runs/clips.mcap --truth test_label.json --pair order --size 1280x720
"""


@dataclass(frozen=True)
class _Options:
    target: Path | None
    truth: Path | None
    pairing: Pairing
    size: tuple[int, int] | None


def main(argv: list[str] | None = None) -> int:
    """``roadperc-lanes``: export a run's lanes, and score them."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    if not (arguments.tusimple or arguments.truth):
        parser.error("expected --tusimple FILE, --truth FILE, or both")
    options = _Options(arguments.tusimple, arguments.truth, arguments.pair, arguments.size)
    return run(lambda: _lanes(arguments.log, options))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="roadperc-lanes",
        description=_DESCRIPTION,
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("log", metavar="OUT.mcap", type=Path, help="a log with results, as roadperc-replay writes it")
    add("--tusimple", metavar="FILE.json", type=Path, help="write the lanes into this file; replaces an earlier one")
    add("--truth", metavar="FILE.json", type=Path, help="true lanes in TuSimple's format")
    add(
        "--pair",
        choices=get_args(Pairing),
        default="stamp",
        help="how true frames find theirs: by the stamp in raw_file, or in order, a line a frame (default stamp)",
    )
    add("--size", metavar="WxH", type=_size, help="image in whose pixels FILE.json is (default the camera's)")
    add("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def _size(text: str) -> tuple[int, int]:
    """An argument such as 1280x720."""
    found = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)
    if not found:
        raise argparse.ArgumentTypeError(f"{text}: expected columns and rows such as 1280x720")
    return int(found[1]), int(found[2])


def _lanes(path: Path, options: _Options) -> None:
    if options.target and options.truth and options.target.resolve() == options.truth.resolve():
        raise LaneFileError(f"{options.target}: is the truth itself; expected another file to write")
    truth = by_key(read_frames(options.truth), options.pairing) if options.truth else {}
    source = open_lanes(path)
    size = options.size or (source.camera.width, source.camera.height)
    with lane_writer(options.target) if options.target else nullcontext(_pass) as write:
        lines = _score(source, truth, options.pairing, size, write) if truth else [_export(source, size, write)]
    print_lines(console_for(sys.stdout), *lines, unbroken=True)


def _pass(_frame: LaneFrame) -> None:
    """Where nothing is to be written."""


def _export(source: RunLanes, size: tuple[int, int], write: Callable[[LaneFrame], None]) -> str:
    """Write every frame; how many there are, and in how many there are lanes."""
    rows = default_rows(size[1])
    frames = seen = 0
    for frames, frame in enumerate(source.frames(), 1):  # noqa: B007
        found = lane_frame(frame, source.camera, size, f"{source.path.stem}/{frame.stamp_ns}", rows)
        seen += bool(found.lanes)
        write(found)
    return f"{source.path.stem}: {frames} frames, lanes in {seen}"


def _score(
    source: RunLanes,
    true_frames: Mapping[int, LaneFrame],
    pairing: Pairing,
    size: tuple[int, int],
    write: Callable[[LaneFrame], None],
) -> list[str | Table]:
    """Write and score the frames that have a truth; what there is to say of them."""
    scores: list[FrameScore] = []
    missing = {truth.raw_file: truth for truth in true_frames.values()}
    for frame, truth in paired(source.frames(), true_frames, pairing):
        found = lane_frame(frame, source.camera, size, truth.raw_file, truth.rows)
        write(found)
        scores.append(score_frame(found, truth, size))
        missing.pop(truth.raw_file, None)
    scores += [unanswered(truth, size) for truth in missing.values()]
    result = summed(scores)
    return [_coverage(source.path.stem, result), *_missing(list(missing)), "", _points(result), "", _lines(result)]


def _coverage(name: str, scores: LaneScores) -> str:
    share = percent(scores.answered / scores.frames)
    return f"{name}: {scores.frames} true frames, lanes in {scores.answered} of them ({share} %)"


def _missing(names: Sequence[str]) -> list[str]:
    """The true frames that the run lacks, by name; nothing where there are none."""
    rest = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return [f"missing in the run, scored as empty: {len(names)}: {', '.join(names[:NAMED])}{rest}"] if names else []


def _points(scores: LaneScores) -> Table:
    table = grid("TuSimple", "frames %", "accuracy", "FP", "FN")
    shares = (f"{value:.4f}" for value in scores.tusimple)
    table.add_row("lane points", percent(scores.answered / scores.frames), *shares)
    return table


def _lines(scores: LaneScores) -> Table:
    table = grid("CULane", "frames %", "precision", "recall", "F1", "right", "wrong", "missed")
    for score in scores.culane:
        ratios = ("" if ratio is None else f"{ratio:.4f}" for ratio in (score.precision, score.recall, score.f1))
        counts = (str(count) for count in (score.tp, score.fp, score.fn))
        table.add_row(score.name, percent(scores.answered / scores.frames), *ratios, *counts)
    return table
