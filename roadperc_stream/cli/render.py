"""``roadperc-render``: render a scenario as a CARLA dump with exact ground truth."""

import argparse
from pathlib import Path
from typing import Final

from roadperc_stream.cli.completers import files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_shared, command_parser, parse
from roadperc_stream.cli.values import image_size

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
    from roadperc_stream.tools.scene.options import FLAGS, RenderOptions

    own = {flag.field: getattr(arguments, flag.field) for group in FLAGS.values() for flag in group}
    options = RenderOptions(*arguments.size, **{**own, "without": tuple(arguments.without or ())})
    return run(lambda: render_and_report(arguments.dump, options, force=arguments.force))


def _parser() -> argparse.ArgumentParser:
    from roadperc_stream.tools.scene.options import FLAGS, RenderOptions

    parser = command_parser("render", "Render a scene as a CARLA dump with exact ground truth.", _EXAMPLE)
    add(parser, "dump", type=Path, metavar="DUMP", help="folder to write", completer=files())
    size = (RenderOptions.width, RenderOptions.height)
    add(parser, "--size", type=image_size, default=size, metavar="WxH", help="pixels (1280x960)")
    for title, flags in FLAGS.items():
        group = parser.add_argument_group(title) if title else parser
        for flag in flags:
            group.add_argument(flag.name, dest=flag.field, **flag.words)
    add_shared(parser, force="replace an earlier dump in the folder")
    return parser
