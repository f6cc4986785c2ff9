"""``roadperc-render``: render a scenario as a CARLA dump with exact ground truth."""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from roadperc_stream.cli.completers import files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_shared, command_parser, parse
from roadperc_stream.cli.values import image_size

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
    size = defaults.width, defaults.height
    add(parser, "dump", type=Path, metavar="DUMP", help="folder to write", completer=files())
    add(parser, "--size", type=image_size, default=size, metavar="WxH", help="pixels (1280x960)")
    without = f"leave out {', '.join(SENSORS)}"
    add(parser, "--without", action="append", choices=SENSORS, default=[], metavar="SENSOR", help=without)
    add(parser, "--seed", type=int, default=defaults.seed, metavar="N", help="seed of all random numbers (0)")
    add_shared(parser, force="replace an earlier dump in the folder")
    _add_flags(
        parser,
        ("--jpeg", "rgb and right as JPEG"),
        ("--lidar", "add a lidar on the roof, 2.4 m high, with exact points"),
    )
    _add_scene(parser.add_argument_group("scene"), SCENES, defaults)
    _add_noise(parser.add_argument_group("noise and drops"))
    _add_lane_changes(parser.add_argument_group("lane changes"))
    _add_road(parser.add_argument_group("road"))
    _add_camera(parser.add_argument_group("camera and pitching"), defaults)
    _add_car_ahead(parser.add_argument_group("car ahead"))
    _add_truth(parser.add_argument_group("truth"))
    return parser


def _add_flags(to: argparse._ActionsContainer, *flags: tuple[str, str]) -> None:
    """Add flags with their help texts."""
    for name, text in flags:
        add(to, name, action="store_true", help=text)


def _add_scene(group: argparse._ArgumentGroup, scenes: Sequence[str], defaults: "RenderOptions") -> None:
    meaning = "bend: radius 150 m; hill: grades up to 8 %%; town (default): bends and hills"
    add(group, "--scene", choices=scenes, default=defaults.scene, help=meaning)
    _add_flags(group, ("--static", "keep the ego car still while others move"))
    for name, key, metavar, text in (
        ("--seconds", "seconds", "S", "length of the scenario"),
        ("--rate", "rate_hz", "HZ", "frames per second"),
        ("--speed", "speed_mps", "MPS", "metres per second along the road"),
        ("--weave", "weave_m", "METRES", "lateral amplitude of the ego car about its lane's centre"),
    ):
        default = getattr(defaults, key)
        add(group, name, type=float, default=default, dest=key, metavar=metavar, help=f"{text} ({default:g})")


def _add_noise(group: argparse._ArgumentGroup) -> None:
    for name, metavar, text in (
        ("--tag-noise", "P", "blobs of wrong classes over a share P of the image, and displaced borders"),
        ("--depth-noise", "R", "relative standard deviation of the depth"),
        ("--rgb-noise", "STD", "standard deviation of the colours in grey levels"),
        ("--drop", "P", "probability of a missing file of a sensor; the first frame is complete"),
    ):
        add(group, name, type=float, default=0.0, metavar=metavar, help=text)
    text = "gain 0.5 to 2 and offset change every second (steps) or frame, or the images turn black (blackouts)"
    add(group, "--exposure", choices=("steps", "frames", "blackouts"), help=text)


def _add_lane_changes(group: argparse._ArgumentGroup) -> None:
    side = "change to a second lane on this side after 2 s, over 3 s"
    add(group, "--change-lane", choices=("left", "right"), help=side)
    _add_flags(
        group,
        ("--change-back", "change back after 2 s, over 3 s"),
        ("--change-broken-off", "abort: return before the line, in 3 s"),
    )


def _add_road(group: argparse._ArgumentGroup) -> None:
    turn = "turn 90 degrees with a radius of 12 m at a crossing without markings, on level ground (left)"
    add(group, "--turn", nargs="?", const="left", choices=("left", "right"), help=turn)
    lane = "event of a second lane on the right after 4 s, over 30 m"
    add(group, "--lane", choices=("begins", "ends", "splits", "merges"), help=lane)
    _add_flags(
        group,
        ("--crossing-cars", "add a crossing where cars cross close ahead"),
        ("--parked-rows", "add rows of parked cars on both sides"),
    )
    stretch = partial(_numbers, form="FROM,TO", example="20,50")
    for name, text in (("--worn-lines", "worn"), ("--missing-lines", "missing")):
        add(group, name, type=stretch, metavar="FROM,TO", help=f"metres of road with {text} markings")


def _add_camera(group: argparse._ArgumentGroup, defaults: "RenderOptions") -> None:
    view = f"horizontal field of view ({defaults.fov_deg:g})"
    add(group, "--fov", type=float, default=defaults.fov_deg, dest="fov_deg", metavar="DEG", help=view)
    add(
        group,
        "--mount",
        type=partial(_numbers, form="X,Y,Z,ROLL,PITCH,YAW", example="1.5,0,1.4,0,-3,0"),
        default=defaults.mount,
        metavar="X,Y,Z,ROLL,PITCH,YAW",
        help="pose of the front camera in CARLA's convention: metres forward, right, up; degrees of roll, pitch up, "
        f"yaw right ({','.join(f'{v:g}' for v in defaults.mount)})",
    )
    pitching = "standard deviation of the car's pitching, degrees (0)"
    add(group, "--pitch-std", type=float, default=0.0, dest="pitch_std_deg", metavar="DEG", help=pitching)
    _add_flags(group, ("--bumps", "add a speed bump every 30 m, 10 cm high"))
    bonnet = "the car's own bonnet hides this share of the image's rows (0.4)"
    add(group, "--bonnet", nargs="?", type=float, const=0.4, default=defaults.bonnet, metavar="SHARE", help=bonnet)


def _add_car_ahead(group: argparse._ArgumentGroup) -> None:
    _add_flags(
        group,
        ("--lead-brakes", "it brakes hard after 2 s; the ego car brakes late and nearly hits it"),
        ("--stop-and-go", "both cars drive, brake and stand repeatedly, in a queue"),
    )


def _add_truth(group: argparse._ArgumentGroup) -> None:
    whole = "boxes of whole objects with hidden parts, like CARLA's 2D boxes, in truth.json and detections.json"
    coding = (
        "write instance_segmentation/ in CARLA's coding: red is the tag, green and blue are the id (low, high byte)"
    )
    path = "add objects in the path, times to impact and lane changes to truth.json; other options imply it"
    _add_flags(group, ("--whole-boxes", whole), ("--instances", coding), ("--path-truth", path))


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
