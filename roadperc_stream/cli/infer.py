"""``roadperc-infer``: write the channels that networks compute from a log's images."""

import argparse
from pathlib import Path
from typing import Final

from roadperc_stream.cli.arguments import about_log
from roadperc_stream.cli.completers import LOGS, files
from roadperc_stream.cli.convert import add_recording_arguments
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_shared, command_parser, parse
from roadperc_stream.schemas.roles import parse_topic_options

_USAGE: Final = """\
%(prog)s [options] IN OUT.mcap --network FILE.toml [--network FILE.toml]
       %(prog)s --check FILE.toml IMAGE [OUT.png]"""
_EXAMPLE: Final = """\
example:
  roadperc-infer drive.mp4 in.mcap --network twinlitenet.toml --network yolox_nano.toml --fov 55 --height 1.3
  roadperc-replay in.mcap out.mcap
  roadperc-infer --check twinlitenet.toml frame.jpg seen.png      show what the network sees

the networks:
  FILE.toml names an .onnx file beside it, and its input, outputs and classes. docs/networks/ has two examples.

videos and images:
  --fov, --calibration, --rate and --height are those of roadperc-convert, and without --rate those of roadperc-replay
  for a log. The height gives the width of markings (default: surface.assumed_height_m).
"""
_CHECK_WORDS: Final = (2, 3)


def main(argv: list[str] | None = None) -> int:
    """``roadperc-infer``: exit code 0 on success, 1 on an error, 2 on wrong usage."""
    parser = _parser()
    arguments = parse(parser, argv)
    if arguments.check is not None:
        if len(arguments.check) not in _CHECK_WORDS or arguments.source is not None:
            parser.error("--check: expected FILE.toml IMAGE [OUT.png] and no other files")
        description, image, *picture = arguments.check
        out = Path(picture[0] if picture else f"{Path(image).stem}.check.png")
        from roadperc_stream.tools.networks.check_picture import check

        return run(lambda: check(Path(description), Path(image), out, force=arguments.force))
    if arguments.out is None or not arguments.network:
        parser.error("expected IN OUT.mcap and --network FILE.toml")
    from roadperc_stream.config import ReplayConfig
    from roadperc_stream.log import is_log
    from roadperc_stream.tools.infer import InferOptions, infer
    from roadperc_stream.tools.layouts.dataset import ConvertOptions

    source_is_log = is_log(arguments.source)
    if arguments.rate is not None and source_is_log:
        parser.error(f"--rate: {arguments.source} is a log, which has its own times")

    def inferred() -> None:
        cfg = about_log(ReplayConfig(), arguments) if source_is_log else ReplayConfig()
        recording = ConvertOptions(
            fov_deg=arguments.fov, rate_hz=arguments.rate, calibration=arguments.calibration, height_m=arguments.height
        )
        topics = parse_topic_options(arguments.topic)
        options = InferOptions(topics, recording, arguments.threads, arguments.force, arguments.quiet)
        infer(arguments.source, arguments.out, arguments.network, cfg, options)

    return run(inferred)


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "infer",
        "Write the segmentation and detections that networks compute from the images, once, so that every replay is\n"
        "fast and repeatable. OUT.mcap contains the input and the new channels.",
        _EXAMPLE,
        _USAGE,
    )
    source = "log, ROS bag, or anything that roadperc-convert reads"
    add(parser, "source", type=Path, nargs="?", metavar="IN", help=source, completer=files(*LOGS))
    add(parser, "out", type=Path, nargs="?", metavar="OUT.mcap", help="log to write", completer=files(*LOGS))
    add(
        parser,
        "--network",
        type=Path,
        action="append",
        default=[],
        metavar="FILE.toml",
        help="description of a network; one may compute the segmentation and one the detections",
        completer=files(".toml"),
    )
    add(
        parser,
        "--check",
        nargs="+",
        metavar="FILE.toml IMAGE",
        help="write a picture of what a network sees in an image, and of its results; default IMAGE.check.png",
    )
    add_recording_arguments(parser)
    add_shared(
        parser,
        topic="use the images of this topic, such as image=/front/rgb",
        threads="images computed at a time (default: one per core); the results do not depend on it",
        force="replace an existing output, and channels of IN that the networks compute",
        quiet="print errors and warnings only",
    )
    return parser
