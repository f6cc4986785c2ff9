"""``roadperc-render``: render a scene as a CARLA dump with exact ground truth."""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from roadperc_stream.cli.completers import completed_by, files
from roadperc_stream.cli.plumbing import command_parser, image_size, parse, part, run

_EXAMPLE: Final = """\
example:
  roadperc-render drive --scene bend --seconds 5 --tag-noise 0.02 --depth-noise 0.01
  roadperc-convert drive drive.mcap

DUMP has the folders rgb, depth, segmentation and right (the second camera of a stereo pair, 0.5 m to the right), and
the files calibration.json, detections.json, poses.json, timestamps.txt and truth.json. If tags or depth are noisy,
dropped or left out, truth/ has the exact ones. With --lidar, lidar/ has PLY files with 64 rings over 90 degrees ahead,
in CARLA's left-handed coordinates (x forward, y right, z up). The same options give the same bytes.
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-render``: exit code 0 on success, 1 on an error, 2 on wrong usage."""
    arguments = parse(_parser(), argv)
    rendering = part("tools.scene.job")
    return run(lambda: rendering.render_and_report(arguments.dump, _options(arguments), force=arguments.force))


def _parser() -> argparse.ArgumentParser:
    facts = part("tools.scene.options")
    defaults = facts.RenderOptions()
    parser = command_parser("render", "Render a scene as a CARLA dump with exact ground truth.", _EXAMPLE)
    add = parser.add_argument
    dump = add("dump", type=Path, metavar="DUMP", help="folder to write")
    add(
        "--size",
        type=image_size,
        default=(defaults.width, defaults.height),
        metavar="WxH",
        help="image size in pixels (1280x960)",
    )
    add("--jpeg", action="store_true", help="write rgb and right as JPEG")
    add("--lidar", action="store_true", help="add a lidar with exact points, 2.4 m above the road")
    add(
        "--without",
        action="append",
        choices=facts.SENSORS,
        default=[],
        metavar="SENSOR",
        help=f"leave out {', '.join(facts.SENSORS)}",
    )
    add("--seed", type=int, default=defaults.seed, metavar="N", help="seed of all random numbers (0)")
    add("--force", action="store_true", help="replace an existing dump")
    _add_drive(parser.add_argument_group("scene and motion"), facts.SCENES, defaults)
    _add_noise(parser.add_argument_group("noise"))
    _add_lane_changes(parser.add_argument_group("lane changes"))
    _add_road(parser.add_argument_group("road"))
    _add_camera(parser.add_argument_group("camera and pitch"), defaults)
    _add_car_before(parser.add_argument_group("car ahead"))
    _add_truth(parser.add_argument_group("truth"))
    completed_by(dump, files())
    return parser


def _add_drive(group: argparse._ArgumentGroup, scenes: Sequence[str], defaults: Any) -> None:
    meaning = "bend: radius 150 m; hill: grades up to 8 %%; town (default): all of these"
    group.add_argument("--scene", choices=scenes, default=defaults.scene, help=meaning)
    group.add_argument("--static", action="store_true", help="keep the ego car still while others move")
    for name, key, metavar, text in (
        ("--seconds", "seconds", "S", "duration in seconds"),
        ("--rate", "rate_hz", "HZ", "frames per second"),
        ("--speed", "speed_mps", "MPS", "speed of the ego car in metres per second"),
        ("--weave", "weave_m", "METRES", "lateral amplitude of the ego car in its lane"),
    ):
        default = getattr(defaults, key)
        group.add_argument(name, type=float, default=default, dest=key, metavar=metavar, help=f"{text} ({default:g})")


def _add_noise(group: argparse._ArgumentGroup) -> None:
    for name, metavar, text in (
        ("--tag-noise", "P", "cover a share P of the image with wrong tags, and distort borders"),
        ("--depth-noise", "R", "relative standard deviation of depth noise"),
        ("--rgb-noise", "STD", "standard deviation of colour noise in grey levels"),
        ("--drop", "P", "probability that a file is missing; the first frame is complete"),
    ):
        group.add_argument(name, type=float, default=0.0, metavar=metavar, help=text)


def _add_lane_changes(group: argparse._ArgumentGroup) -> None:
    side = "change lane after 2 s, within 3 s, to a second lane in the same direction"
    group.add_argument("--change-lane", choices=("left", "right"), help=side)
    group.add_argument(
        "--change-back", action="store_true", help="with --change-lane: change back after 2 s, within 3 s"
    )
    group.add_argument(
        "--change-broken-off",
        action="store_true",
        help="with --change-lane: return before crossing the line, within 3 s",
    )


def _add_road(group: argparse._ArgumentGroup) -> None:
    turn = "turn 90 degrees with a radius of 12 m at a crossing without markings, on level ground (left)"
    group.add_argument("--turn", nargs="?", const="left", choices=("left", "right"), help=turn)
    lane = "a second lane on the right begins, ends, splits off or merges after 4 s, over 30 m"
    group.add_argument("--lane", choices=("begins", "ends", "splits", "merges"), help=lane)
    group.add_argument("--crossing-cars", action="store_true", help="add a crossing with cars that cross close ahead")
    group.add_argument("--parked-rows", action="store_true", help="add rows of parked cars without gaps on both sides")
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
    text = "standard deviation of the car's pitch in degrees (0)"
    add("--pitch-std", type=float, default=0.0, dest="pitch_std_deg", metavar="DEG", help=text)
    add("--bumps", action="store_true", help="add a speed bump of 10 cm every 30 m")


def _add_car_before(group: argparse._ArgumentGroup) -> None:
    hard = "the car ahead brakes hard after 2 s; the ego car brakes late and nearly collides"
    group.add_argument("--lead-brakes", action="store_true", help=hard)
    group.add_argument(
        "--stop-and-go", action="store_true", help="both cars drive, brake, stand and drive on, in a queue"
    )


def _add_truth(group: argparse._ArgumentGroup) -> None:
    text = "add objects in the path, their time to impact, and lane changes to truth.json"
    whole = "write boxes of whole objects, with their hidden parts, as CARLA does"
    group.add_argument("--whole-boxes", action="store_true", help=f"{whole}, to truth.json and detections.json")
    coding = (
        "write instance_segmentation/ in CARLA's coding: red is the tag, green and blue the low and high byte of the id"
    )
    group.add_argument("--instances", action="store_true", help=coding)
    group.add_argument("--path-truth", action="store_true", help=f"{text}; implied by the other scene options")


def _options(arguments: argparse.Namespace) -> Any:
    """The arguments as ``tools.scene.options.RenderOptions``."""
    width, height = arguments.size
    own = {key: value for key, value in vars(arguments).items() if key not in ("dump", "size", "force", "without")}
    return part("tools.scene.options").RenderOptions(
        width=width, height=height, without=tuple(arguments.without), **own
    )


def _numbers(text: str, form: str, example: str) -> tuple[float, ...]:
    """The numbers of an option of a form such as ``X,Y``."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != len(form.split(",")):
        raise argparse.ArgumentTypeError(f"{text!r}: expected {form}, such as {example}")
    return values
