"""``roadperc-render``: render a scenario as a CARLA dump with exact ground truth."""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from roadperc_stream.cli.completers import completed_by, files
from roadperc_stream.cli.plumbing import command_parser, image_size, parse, run

if TYPE_CHECKING:
    from roadperc_stream.tools.scene.options import RenderOptions

_EXAMPLE: Final = """\
example:
  roadperc-render bend --scene bend --seconds 5 --tag-noise 0.02 --depth-noise 0.01
  roadperc-convert bend bend.mcap

DUMP then holds rgb/, depth/, segmentation/ and right/ (the second camera of a stereo pair, 0.5 m to the right),
calibration.json, detections.json, poses.json, timestamps.txt and truth.json. With noise, drops or --without it also
holds the clean tags and depth in truth/. With --lidar it holds lidar/: 64 rings over 90 degrees ahead, as PLY files
with CARLA's left-handed x forward, y right, z up. The same options give the same bytes.
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-render``: exit code 0 on success, 1 on an error, 2 on wrong usage."""
    arguments = parse(_parser(), argv)
    from roadperc_stream.tools.scene.job import render_and_report

    return run(lambda: render_and_report(arguments.dump, _options(arguments), force=arguments.force))


def _parser() -> argparse.ArgumentParser:
    from roadperc_stream.tools.scene.options import SCENES, SENSORS, RenderOptions

    defaults = RenderOptions()
    parser = command_parser("render", "Render a scene as a CARLA dump with exact ground truth.", _EXAMPLE)
    add = parser.add_argument
    dump = add("dump", type=Path, metavar="DUMP", help="folder to write")
    add("--size", type=image_size, default=(defaults.width, defaults.height), metavar="WxH", help="pixels (1280x960)")
    add("--jpeg", action="store_true", help="rgb and right as JPEG")
    add("--lidar", action="store_true", help="add a lidar on the roof, 2.4 m high, with exact points")
    add(
        "--without",
        action="append",
        choices=SENSORS,
        default=[],
        metavar="SENSOR",
        help=f"leave out {', '.join(SENSORS)}",
    )
    add("--seed", type=int, default=defaults.seed, metavar="N", help="seed of all random numbers (0)")
    add("--force", action="store_true", help="replace an earlier dump in the folder")
    _add_scene(parser.add_argument_group("scene"), SCENES, defaults)
    _add_noise(parser.add_argument_group("noise and drops"))
    _add_lane_changes(parser.add_argument_group("lane changes"))
    _add_road(parser.add_argument_group("road"))
    _add_camera(parser.add_argument_group("camera and pitching"), defaults)
    _add_car_ahead(parser.add_argument_group("car ahead"))
    _add_truth(parser.add_argument_group("truth"))
    completed_by(dump, files())
    return parser


def _add_scene(group: argparse._ArgumentGroup, scenes: Sequence[str], defaults: Any) -> None:
    meaning = "bend: radius 150 m; hill: grades up to 8 %%; town (default): bends and hills"
    group.add_argument("--scene", choices=scenes, default=defaults.scene, help=meaning)
    group.add_argument("--static", action="store_true", help="keep the ego car still while others move")
    for name, key, metavar, text in (
        ("--seconds", "seconds", "S", "length of the scenario"),
        ("--rate", "rate_hz", "HZ", "frames per second"),
        ("--speed", "speed_mps", "MPS", "metres per second along the road"),
        ("--weave", "weave_m", "METRES", "lateral amplitude of the ego car about its lane's centre"),
    ):
        default = getattr(defaults, key)
        group.add_argument(name, type=float, default=default, dest=key, metavar=metavar, help=f"{text} ({default:g})")


def _add_noise(group: argparse._ArgumentGroup) -> None:
    for name, metavar, text in (
        ("--tag-noise", "P", "blobs of wrong classes over a share P of the image, and displaced borders"),
        ("--depth-noise", "R", "relative standard deviation of the depth"),
        ("--rgb-noise", "STD", "standard deviation of the colours in grey levels"),
        ("--drop", "P", "probability of a missing file of a sensor; the first frame is complete"),
    ):
        group.add_argument(name, type=float, default=0.0, metavar=metavar, help=text)
    text = "gain 0.5 to 2 and offset change every second (steps) or frame, or the images turn black (blackouts)"
    group.add_argument("--exposure", choices=("steps", "frames", "blackouts"), help=text)


def _add_lane_changes(group: argparse._ArgumentGroup) -> None:
    side = "change to a second lane on this side after 2 s, over 3 s"
    group.add_argument("--change-lane", choices=("left", "right"), help=side)
    group.add_argument("--change-back", action="store_true", help="change back after 2 s, over 3 s")
    group.add_argument("--change-broken-off", action="store_true", help="abort: return before the line, in 3 s")


def _add_road(group: argparse._ArgumentGroup) -> None:
    turn = "turn 90 degrees with a radius of 12 m at a crossing without markings, on level ground (left)"
    group.add_argument("--turn", nargs="?", const="left", choices=("left", "right"), help=turn)
    lane = "event of a second lane on the right after 4 s, over 30 m"
    group.add_argument("--lane", choices=("begins", "ends", "splits", "merges"), help=lane)
    group.add_argument("--crossing-cars", action="store_true", help="add a crossing where cars cross close ahead")
    group.add_argument("--parked-rows", action="store_true", help="add rows of parked cars on both sides")
    stretch = partial(_numbers, form="FROM,TO", example="20,50")
    for name, text in (("--worn-lines", "worn"), ("--missing-lines", "missing")):
        group.add_argument(name, type=stretch, metavar="FROM,TO", help=f"metres of road with {text} markings")


def _add_camera(group: argparse._ArgumentGroup, defaults: Any) -> None:
    add, fov, mount = group.add_argument, defaults.fov_deg, defaults.mount
    add("--fov", type=float, default=fov, dest="fov_deg", metavar="DEG", help=f"horizontal field of view ({fov:g})")
    add(
        "--mount",
        type=partial(_numbers, form="X,Y,Z,ROLL,PITCH,YAW", example="1.5,0,1.4,0,-3,0"),
        default=mount,
        metavar="X,Y,Z,ROLL,PITCH,YAW",
        help="pose of the front camera in CARLA's convention: metres forward, right, up; degrees of roll, pitch up, "
        "yaw right "
        f"({','.join(f'{v:g}' for v in mount)})",
    )
    text = "standard deviation of the car's pitching, degrees (0)"
    add("--pitch-std", type=float, default=0.0, dest="pitch_std_deg", metavar="DEG", help=text)
    add("--bumps", action="store_true", help="add a speed bump every 30 m, 10 cm high")
    text = "the car's own bonnet hides this share of the image's rows (0.4)"
    add("--bonnet", nargs="?", type=float, const=0.4, default=defaults.bonnet, metavar="SHARE", help=text)


def _add_car_ahead(group: argparse._ArgumentGroup) -> None:
    hard = "it brakes hard after 2 s; the ego car brakes late and nearly hits it"
    group.add_argument("--lead-brakes", action="store_true", help=hard)
    group.add_argument(
        "--stop-and-go", action="store_true", help="both cars drive, brake and stand repeatedly, in a queue"
    )


def _add_truth(group: argparse._ArgumentGroup) -> None:
    text = "add objects in the path, times to impact and lane changes to truth.json"
    whole = "boxes of whole objects with hidden parts, like CARLA's 2D boxes"
    group.add_argument("--whole-boxes", action="store_true", help=f"{whole}, in truth.json and detections.json")
    coding = (
        "write instance_segmentation/ in CARLA's coding: red is the tag, green and blue are the id (low, high byte)"
    )
    group.add_argument("--instances", action="store_true", help=coding)
    group.add_argument("--path-truth", action="store_true", help=f"{text}; other options imply it")


def _options(arguments: argparse.Namespace) -> "RenderOptions":
    from roadperc_stream.tools.scene.options import RenderOptions

    width, height = arguments.size
    own = {key: value for key, value in vars(arguments).items() if key not in ("dump", "size", "force", "without")}
    return RenderOptions(width=width, height=height, without=tuple(arguments.without), **own)


def _numbers(text: str, form: str, example: str) -> tuple[float, ...]:
    """Return the numbers of an option; ``form`` gives their count."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != len(form.split(",")):
        raise argparse.ArgumentTypeError(f"{text!r}: expected {form}, such as {example}")
    return values
