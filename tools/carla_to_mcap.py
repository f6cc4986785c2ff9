"""``roadperc-convert``: a CARLA dump folder to a log."""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.progress import Progress

from roadperc_stream import __version__
from roadperc_stream.cli.plumbing import run, telling
from roadperc_stream.cli.terminal import print_lines
from roadperc_stream.core.files import require_free
from roadperc_stream.errors import DumpError
from roadperc_stream.log import LogWriter, Message, Metadata

from .carla_dump.messages import channels, messages
from .carla_dump.plan import Options, Plan, make_plan
from .carla_dump.report import console, print_plan
from .carla_dump.role_names import ROLES

_MISSING: Final = "counted as missing: {}"
_EPILOG: Final = """\
example:
  roadperc-convert recordings/town04 town04.mcap
  roadperc-convert recordings/old old.mcap --carla 0.9.10 --fov 90 --role depth=CameraDepth2

the dump:
  one folder per sensor (rgb, CameraRGB, image_2, depth, segmentation, sem, left, right, ...) with a file per frame,
  paired by the last number in each name; or flat files such as left.png and right.png. A lidar's points (lidar,
  velodyne, ...) are CARLA's .ply or .npy, left-handed, or KITTI's .bin, right-handed. Beside them, where there are:
  calibration.json   K, or fov_deg; width, height; P_left and P_right, or baseline_m; carla_tags; rate_hz;
                     mounting {role: {x, y, z, roll, pitch, yaw}} as CARLA has it; cameras {role: {K, ...}} for those
                     that differ; pixel_origin "corner" (c = w / 2, the default) or "centre"; mounting.lidar too
  detections.json    {frame: [{label, box_px, score}]}, COCO results, or KITTI files in label_2/
  timestamps.txt     lines 'frame seconds', or a value a line
  poses.json         {frame: {location, rotation}}, or poses.csv; truth.json and truth/ as roadperc-render writes
"""


def main(argv: list[str] | None = None) -> int:
    """Convert a dump; 0 done, 1 a stated error, 2 wrong usage."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    quiet, force = arguments.quiet, arguments.force
    return run(lambda: _convert(arguments.dump, arguments.out, _options(parser, arguments), force=force, quiet=quiet))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="roadperc-convert",
        description="Makes a log of a CARLA dump folder. Finds the layout by itself and says what it found.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("dump", type=Path, metavar="DUMP", help="folder with one folder per sensor, or flat files")
    parser.add_argument("out", type=Path, metavar="IN.mcap", help="log to write; it appears only when complete")
    parser.add_argument("--role", action="append", default=[], metavar="ROLE=PATH", help=f"roles: {', '.join(ROLES)}")
    parser.add_argument("--carla", metavar="VERSION", help="CARLA version that wrote the tags, such as 0.9.15")
    parser.add_argument("--fov", type=_field_of_view, metavar="DEGREES", help="horizontal field of view")
    parser.add_argument(
        "--rate", type=_positive, metavar="HZ", help="frames per second (20, or rate_hz, or timestamps)"
    )
    parser.add_argument(
        "--depth",
        choices=("mm", "float"),
        default="mm",
        help="written as millimetres or metres",
    )
    parser.add_argument("--allow-lossy-tags", action="store_true", help="take the nearest tag of a JPEG")
    parser.add_argument("--force", action="store_true", help="replace an existing log")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    parser.add_argument("--version", action="version", version=__version__)
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not 1e-3 <= value <= 1e6:
        raise argparse.ArgumentTypeError(f"{text}: expected a number from 0.001 to 1000000")
    return value


def _field_of_view(text: str) -> float:
    value = _positive(text)
    if value >= 180:
        raise argparse.ArgumentTypeError(f"{text}: expected degrees below 180")
    return value


def _options(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> Options:
    roles = {}
    for option in arguments.role:
        role, separator, name = option.partition("=")
        if not separator or not name or role not in ROLES:
            parser.error(f"--role {option}: expected ROLE=PATH with a role of {', '.join(ROLES)}")
        roles[role] = _role_path(arguments.dump, role, name)
    return Options(
        roles=roles,
        carla=arguments.carla,
        fov_deg=arguments.fov,
        rate_hz=arguments.rate,
        depth_as_float=arguments.depth == "float",
        allow_lossy_tags=arguments.allow_lossy_tags,
    )


def _role_path(dump: Path, role: str, name: str) -> Path:
    """Path of ``--role``: inside the dump, else as it stands."""
    found = next((path for path in (dump / name, Path(name)) if path.exists()), None)
    if found is None:
        raise DumpError(f"--role {role}={name}: no such file or folder, neither in {dump} nor here")
    return found


@dataclass
class _Progress:
    """Messages by role, and files that turned out to be no frames."""

    counts: Counter[str]
    unreadable: list[str]


def _convert(dump: Path, out: Path, options: Options, *, force: bool, quiet: bool) -> None:
    require_free(out, force=force, suffix=".mcap")
    started = time.monotonic()
    plan = make_plan(dump, options)
    terminal = console(quiet=quiet)
    with telling():
        print_plan(terminal, plan)
    _warn((*plan.warnings, *map(_MISSING.format, plan.unreadable)))
    done = _write(plan, out, force=force, quiet=quiet)
    _warn(map(_MISSING.format, done.unreadable))
    megabytes, seconds = out.stat().st_size / 1e6, time.monotonic() - started
    said = f"{done.counts.total()} messages, {megabytes:.1f} MB, {seconds:.1f} s: {out}"
    print_lines(terminal, said, unbroken=True)


def _warn(texts: Iterable[str]) -> None:
    with telling(sys.stderr):
        for text in texts:
            print(f"warning: {text}", file=sys.stderr)


def _write(plan: Plan, out: Path, *, force: bool, quiet: bool) -> _Progress:
    done = _Progress(Counter(), [])
    with LogWriter(out) as log:
        for channel in channels(plan).values():
            log.register(channel)
        for role, message in _shown(messages(plan, done.unreadable), plan, quiet=quiet):
            log.write(message)
            done.counts[role] += 1
        lost = [role for role in plan.surveys if not done.counts[role]]
        if lost:
            raise DumpError(f"{lost[0]}: no file can be read; {(done.unreadable or ['none has a frame'])[0]}")
        log.describe(_description(plan))
        require_free(out, force=force, suffix=".mcap")  # another program may have written it meanwhile
    return done


def _shown(stream: Iterable[tuple[str, Message]], plan: Plan, *, quiet: bool) -> Iterator[tuple[str, Message]]:
    """The same messages, with a progress bar on a terminal."""
    terminal = Console(stderr=True)
    with Progress(console=terminal, disable=quiet or not terminal.is_terminal, transient=True) as bar:
        task = bar.add_task("writing", total=len(plan.stamps_ns))
        for role, message in stream:
            bar.update(task, completed=message.sequence)
            yield role, message


def _description(plan: Plan) -> Metadata:
    """How the log was made: nothing of the machine or the user."""
    encodings = {f"encoding.{role}": survey.encoding for role, survey in plan.surveys.items()}
    table = {"tag_table": plan.tag_table.name, "tag_table_known_by": plan.tag_table_source} if plan.tag_table else {}
    values = {"version": __version__, "frames": str(len(plan.stamps_ns)), "time": plan.timing, **encodings, **table}
    return Metadata("roadperc_convert", tuple(sorted(values.items())))


if __name__ == "__main__":
    sys.exit(main())
