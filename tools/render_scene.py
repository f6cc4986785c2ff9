"""``roadperc-render``: a drive rendered in CARLA's own file formats, with exact ground truth."""

import argparse
import sys
import time
from itertools import count
from pathlib import Path
from typing import Final

from roadperc_stream.cli.plumbing import frame_progress, run

from .scene.dump import SENSORS
from .scene.job import RenderOptions, render_dump
from .scene.world import SCENES

EXAMPLE: Final = """\
example:
  roadperc-render drive --scene bend --seconds 5 --tag-noise 0.02 --depth-noise 0.01
  roadperc-convert drive drive.mcap

DUMP then holds rgb/, depth/, segmentation/ and right/ (the second camera of a stereo pair, 0.5 m to the right),
calibration.json, detections.json, poses.json, timestamps.txt, truth.json, and truth/ with the clean tags and depth
where noise or drops spoil the others, or they are left out. With --lidar it also holds lidar/: 64 rings over 90 degrees
ahead, PLY files with CARLA's left-handed x forward, y right, z up. The same options give the same bytes.
"""


def main(argv: list[str] | None = None) -> int:
    """The command line: 0 done, 1 a stated error, 2 wrong usage."""
    arguments = _parser().parse_args(argv)
    return run(lambda: _render(arguments.dump, _options(arguments), force=arguments.force))


def _render(dump: Path, options: RenderOptions, *, force: bool) -> None:
    options.check()
    started = time.perf_counter()
    with frame_progress("rendering", enabled=True) as progress:
        done = count(1)
        render_dump(dump, options, force=force, on_frame=lambda: progress(next(done), options.frames))
    seconds = time.perf_counter() - started
    size, rate = f"{options.width}x{options.height}", options.frames / seconds
    print(f"{options.frames} frames of {size} in {seconds:.1f} s ({rate:.1f} frames/s): {dump}")


def _options(arguments: argparse.Namespace) -> RenderOptions:
    width, height = arguments.size
    own = {key: value for key, value in vars(arguments).items() if key not in ("dump", "size", "force", "without")}
    return RenderOptions(width=width, height=height, without=tuple(arguments.without), **own)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT, such as 1280x960")
    return int(width), int(height)


def _parser() -> argparse.ArgumentParser:
    defaults = RenderOptions()
    parser = argparse.ArgumentParser(
        prog="roadperc-render",
        description="Renders a drive as a CARLA dump with exact ground truth.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("dump", type=Path, metavar="DUMP", help="folder to write")
    add("--size", type=_size, default=(defaults.width, defaults.height), metavar="WxH", help="pixels (1280x960)")
    add("--jpeg", action="store_true", help="rgb and right as JPEG")
    add("--lidar", action="store_true", help="a lidar on the roof, 2.4 m high: its points are exact")
    add(
        "--without",
        action="append",
        choices=SENSORS,
        default=[],
        metavar="SENSOR",
        help=f"leave out {', '.join(SENSORS)}",
    )
    add("--seed", type=int, default=defaults.seed, metavar="N", help="everything random comes from it (0)")
    add("--force", action="store_true", help="replace an earlier dump in the folder")
    _add_drive(parser.add_argument_group("the drive"), defaults)
    _add_spoiling(parser.add_argument_group("spoiling"))
    return parser


def _add_drive(group: argparse._ArgumentGroup, defaults: RenderOptions) -> None:
    scenes = "bend: radius 150 m; hill: grades to 8 %%; town (default): all of it"
    group.add_argument("--scene", choices=SCENES, default=defaults.scene, help=scenes)
    group.add_argument("--static", action="store_true", help="the ego car stands still; the others move")
    for name, key, metavar, text in (
        ("--seconds", "seconds", "S", "length of the drive"),
        ("--rate", "rate_hz", "HZ", "frames per second"),
        ("--speed", "speed_mps", "MPS", "metres per second along the road"),
        ("--weave", "weave_m", "METRES", "how far the ego car weaves to either side of its lane's middle"),
    ):
        default = getattr(defaults, key)
        group.add_argument(name, type=float, default=default, dest=key, metavar=metavar, help=f"{text} ({default:g})")


def _add_spoiling(group: argparse._ArgumentGroup) -> None:
    for name, metavar, text in (
        ("--tag-noise", "P", "blobs of wrong classes over a share P of the image, and wobbling borders"),
        ("--depth-noise", "R", "relative standard deviation of the depth"),
        ("--rgb-noise", "STD", "standard deviation of the colours, grey levels"),
        ("--drop", "P", "probability that a sensor's file is missing; the first frame is whole"),
    ):
        group.add_argument(name, type=float, default=0.0, metavar=metavar, help=text)


if __name__ == "__main__":
    sys.exit(main())
