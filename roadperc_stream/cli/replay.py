"""The commands of the package: arguments in, exit code out."""

import argparse
from pathlib import Path

from roadperc_stream import __version__
from roadperc_stream.cli.plumbing import frame_progress, run, seconds, telling, whole_number
from roadperc_stream.core.config import NEEDS, STAGES, load_config, switched_off
from roadperc_stream.core.time import TimeRange
from roadperc_stream.errors import ConfigError
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.output.writing import unwatched
from roadperc_stream.replay import ReplaySummary, replay
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.schemas.topics import Request
from roadperc_stream.view.live.options import add_serving_arguments, given_options, serving_options
from roadperc_stream.view.live.serving import LiveReplay

_REPLAY_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap out.mcap --set lanes.hold_s=0.8 --set surface.inlier_m=0.03
  roadperc-report out.metrics.parquet
  roadperc-replay logs/sample.mcap pictures.mcap --overlay --debug

A log with topics of its own names them by role, such as --topic image=/front/rgb --topic depth=/front/depth.
"""


def replay_main(argv: list[str] | None = None) -> int:
    """``roadperc-replay``: the main job."""
    parser = _replay_parser()
    arguments = parser.parse_args(argv)
    if given_options(arguments) and not arguments.live:
        parser.error(f"--{given_options(arguments)[0]}: for --live only")
    return run(lambda: _replay(arguments))


def _replay_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="roadperc-replay",
        description="Replay a log through the perception chain: OUT.mcap holds the input and the results, "
        "OUT.metrics.parquet a row per frame, OUT.objects.parquet a row per detection.",
        epilog=_REPLAY_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("source", metavar="IN.mcap", type=Path)
    parser.add_argument("target", metavar="OUT.mcap", type=Path)
    add_input_arguments(parser)
    parser.add_argument(
        "--only",
        metavar="STAGES",
        type=_stages,
        help=f"some of {','.join(STAGES)}, with what they need; without a depth sensor name stereo among them",
    )
    parser.add_argument("--results-only", action="store_true", help="leave the input's messages out of OUT.mcap")
    parser.add_argument(
        "--overlay", action="store_true", help="write /perception/overlay: the camera image with everything drawn in"
    )
    parser.add_argument(
        "--debug", action="store_true", help="write /perception/debug/...: proposed lines, matches, template, disparity"
    )
    parser.add_argument("--force", action="store_true", help="replace an existing OUT.mcap")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    parser.add_argument("--live", action="store_true", help="serve the results to Foxglove while they are computed")
    add_serving_arguments(parser)
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def add_input_arguments(parser: argparse.ArgumentParser) -> None:
    """The settings, the topics and the part of the log: options of every command that replays."""
    parser.add_argument("--config", metavar="FILE", type=Path, help="TOML file with any part of the settings")
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help="one setting; wins over FILE")
    parser.add_argument("--topic", metavar="ROLE=/NAME", action="append", default=[], help="the topic of a role")
    parser.add_argument("--start", metavar="SECONDS", type=seconds, help="from here, counted from the first message")
    parser.add_argument("--end", metavar="SECONDS", type=seconds, help="up to here, counted from the first message")
    parser.add_argument("--frames", metavar="N", type=whole_number, help="at most so many frames")


def cut_of(arguments: argparse.Namespace) -> TimeRange:
    """The part of the log that the options name.

    Raises:
        ConfigError: it ends before it starts.
    """
    if arguments.start is not None and arguments.end is not None and arguments.end <= arguments.start:
        raise ConfigError(f"--end {arguments.end}: expected more than --start {arguments.start}")
    return TimeRange(arguments.start, arguments.end, arguments.frames)


def _stages(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    unknown = [name for name in names if name not in STAGES]
    if unknown:
        raise argparse.ArgumentTypeError(f"no stage {unknown[0]!r}; stages: {', '.join(STAGES)}")
    return names + tuple(needed for name in names for needed in NEEDS.get(name, ()))


def _replay(arguments: argparse.Namespace) -> None:
    only = arguments.only or STAGES
    off = tuple(switched_off(stage) for stage in STAGES if stage not in only)
    cut = cut_of(arguments)
    with LiveReplay(serving_options(arguments), quiet=arguments.quiet) as live:
        with frame_progress("replaying", not arguments.quiet) as progress:
            summary = replay(
                arguments.source,
                arguments.target,
                load_config(arguments.config, (*arguments.set, *off)),
                overrides=parse_topic_options(arguments.topic),
                cut=cut,
                results_only=arguments.results_only,
                on_request=_requests(arguments),
                force=arguments.force,
                progress=progress,
                opened=live.start if arguments.live else unwatched,
            )
        if not arguments.quiet:
            with telling():
                _print_summary(arguments.target, summary)
        live.wait()


def _requests(arguments: argparse.Namespace) -> tuple[Request, ...]:
    """The pictures that the options ask for."""
    asked: dict[Request, bool] = {"overlay": arguments.overlay, "debug": arguments.debug}
    return tuple(request for request, wanted in asked.items() if wanted)


def _print_summary(target: Path, summary: ReplaySummary) -> None:
    for note in (*summary.notes, *summary.throughout):
        print(f"note: {note}")
    for topic, number in summary.problems.items():
        print(f"warning: {number} messages on {topic} could not be read; they are copied, their frames go without")
    for role, number in summary.dropped.items():
        print(f"note: {number} messages of role {role} belong to no frame")
    rate = summary.frames / summary.seconds
    print(f"{summary.frames} frames in {summary.seconds:.1f} s ({rate:.0f} a second), log {summary.log_id}")
    print(
        f"wrote {target} ({summary.messages_out} messages), {sidecar_path(target, 'metrics').name}, "
        f"{sidecar_path(target, 'objects').name}"
    )
