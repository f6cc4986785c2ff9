"""``roadperc-convert``: convert a dump folder, images or videos to a log."""

import argparse
from pathlib import Path
from typing import Final

from roadperc_stream.cli.completers import LOGS, files, words
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_shared, command_parser, parse
from roadperc_stream.cli.values import number
from roadperc_stream.errors import DumpError
from roadperc_stream.schemas.role_names import ROLES

_EXAMPLE: Final = """\
example:
  roadperc-convert recordings/town04 town04.mcap
  roadperc-convert recordings/old old.mcap --carla 0.9.10 --fov 90 --role depth=CameraDepth2
  roadperc-convert kitti/dataset kitti.mcap --sequence 05
  roadperc-convert drive.mp4 drive.mcap --fov 55 --height 1.3
  roadperc-convert dashcam/ drive.mcap --calibration ost.yaml

videos:
  A video, or a folder of videos: files of one log, in the order of their names. The stamps are those of the video.
  Each frame is stored as JPEG, upright. Without a calibration of the camera, pass --fov.

datasets:
  KITTI odometry: the folder with sequences/ and poses/ (choose one with --sequence NN), or one sequence.
  KITTI raw, object and tracking: the folder with training/, or with drives and calib_*.txt.
  TuSimple: the folder with label_data_*.json and clips/. CULane: a folder with *.lines.txt. Pass --fov and --height.
  Cityscapes: the folder with leftImg8bit/ and gtFine/. Pass --fov. --sequence train/aachen chooses a city.
  nuScenes: the folder with v1.0-*/. CARLA leaderboard: a route with rgb/ and measurements/. Bench2Drive: a clip.
  The table of docs/recordings.md says what comes out. Calibration, stamps and true poses are those of the dataset.

images:
  A folder of numbered images, or one folder with them. Pass --fov and --rate.

a dump:
  One folder per sensor (rgb, CameraRGB, image_2, depth, segmentation, sem, left, right, ...) with one file per frame.
  The last number in each name pairs the files. Flat files such as left.png and right.png are read too.
  Lidar points (lidar, velodyne, ...) are left-handed in CARLA's .ply, .npy and .laz, right-handed in KITTI's .bin.

optional files:
  calibration.json   K or fov_deg; width, height; P_left and P_right, or baseline_m; carla_tags; rate_hz
                     mounting {role: {x, y, z, roll, pitch, yaw}} in CARLA's convention; a role may be lidar
                     cameras {role: {K, ...}} for cameras with other values
                     pixel_origin "corner" (c = w / 2, CARLA) or "centre" (KITTI, the default in its layout)
                     D, distortion_model (plumb_bob, rational_polynomial, equidistant), R and P as in ROS' CameraInfo:
                     distortion is removed, and the log holds the rectified images
  detections.json    {frame: [{label, box_px, score}]}, COCO results, KITTI files in label_2/, or YOLO files in labels/
                     with the names of data.yaml or classes.txt
  timestamps.txt     one line per frame: 'frame seconds', or seconds
  poses.json         {frame: {location, rotation}}, or poses.csv
  truth.json, truth/ as roadperc-render writes them
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-convert``: exit code 0 on success, 1 on an error, 2 on wrong usage."""
    parser = _parser()
    arguments = parse(parser, argv)
    roles = dict(_role(parser, option) for option in arguments.role)
    from roadperc_stream.tools.conversion import convert
    from roadperc_stream.tools.layouts.dataset import ConvertOptions

    def converted() -> None:
        options = ConvertOptions(
            roles={role: _role_path(arguments.dump, role, name) for role, name in roles.items()},
            tags=arguments.tags,
            fov_deg=arguments.fov,
            rate_hz=arguments.rate,
            depth_as_float=arguments.depth == "float",
            allow_lossy_tags=arguments.allow_lossy_tags,
            depth_coding=arguments.depth_coding,
            calibration=arguments.calibration,
            height_m=arguments.height,
            layout=arguments.layout,
            sequence=arguments.sequence,
        )
        convert(arguments.dump, arguments.out, options, force=arguments.force, quiet=arguments.quiet)

    return run(converted)


def add_recording_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of videos and images, and of a dump with one camera."""
    default = "default: calibration.json of the recording"
    calibration = f"calibration of the camera: camera_info YAML of ROS, or JSON ({default})"
    add_shared(parser, "fov", "height", calibration=calibration)
    rate = "frames per second (default: timestamps, or rate_hz, or 20)"
    add(parser, "--rate", type=number(1e-3, 1e6, "a number from 0.001 to 1000000"), metavar="HZ", help=rate)


def _parser() -> argparse.ArgumentParser:
    from roadperc_stream.tools.layouts import LAYOUTS

    parser = command_parser(
        "convert",
        "Convert a dataset, a CARLA dump, images or videos to a log. The command detects the layout and prints it.",
        _EXAMPLE,
    )
    recording = "folder of a dataset, with one folder per sensor, of images or videos, or one video"
    add(parser, "dump", type=Path, metavar="RECORDING", help=recording, completer=files())
    add(parser, "out", type=Path, metavar="IN.mcap", help="log to write", completer=files(*LOGS))
    add(
        parser,
        "--role",
        action="append",
        default=[],
        metavar="ROLE=PATH",
        help=f"use this folder for a role: {', '.join(ROLES)}",
        completer=words(f"{role}=" for role in ROLES),
    )
    layout = f"read the folder as this layout (default: detected): {', '.join(LAYOUTS)}"
    add(parser, "--layout", choices=LAYOUTS, metavar="NAME", help=layout)
    add(parser, "--sequence", metavar="NN", help="sequence of a dataset with several")
    add(parser, "--carla", dest="tags", metavar="VERSION", help="CARLA version of the tags, such as 0.9.15")
    tags = "table of the tags: a dataset's name, such as cityscapes, or a TOML file"
    add(parser, "--tags", metavar="TABLE", help=tags, completer=files(".toml"))
    add_recording_arguments(parser)
    depth = "write depth as 16-bit millimetres or as float metres (default mm)"
    add(parser, "--depth", choices=("mm", "float"), default="mm", help=depth)
    add(
        parser,
        "--depth-coding",
        "--grey-depth",
        choices=("mm", "cm", "m", "depth-256", "tum", "disparity", "linear", "linear-50", "logarithmic"),
        help="coding of depth files whose content does not show it: unit of numbers, KITTI's depth or disparity * 256, "
        "TUM's depth * 5000, or coding of 8-bit images (default: metres of floats, mm of integers, the grey that gives "
        "a level ground)",
    )
    lossy = "accept JPEG segmentation, and use the nearest tag of each pixel"
    add(parser, "--allow-lossy-tags", action="store_true", help=lossy)
    add_shared(parser, "quiet", force="replace an existing log")
    return parser


def _role(parser: argparse.ArgumentParser, option: str) -> tuple[str, str]:
    """The role and the path of a ``--role`` option."""
    role, separator, name = option.partition("=")
    if not separator or not name or role not in ROLES:
        parser.error(f"--role {option}: expected ROLE=PATH with a role of {', '.join(ROLES)}")
    return role, name


def _role_path(dump: Path, role: str, name: str) -> Path:
    """The path of ``--role``: inside the dump, else relative to the working directory."""
    found = next((path for path in (dump / name, Path(name)) if path.exists()), None)
    if found is None:
        raise DumpError(f"--role {role}={name}: no such file or folder in {dump} or in the working directory")
    return found
