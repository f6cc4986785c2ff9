"""What ``roadperc-replay`` does with its arguments, and what it says of the replay."""

import argparse
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from roadperc_stream.cli.arguments import config_of, time_range_of
from roadperc_stream.core.process import optional_output
from roadperc_stream.core.text import print_line
from roadperc_stream.loop import ReplaySummary, replay
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.output.writing import unwatched
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.schemas.topics import Request

if TYPE_CHECKING:
    from roadperc_stream.view.live.serving import LiveReplay


def replay_log(arguments: argparse.Namespace, live: "LiveReplay | None") -> None:
    """Replay a log as the arguments say, and print what came of it.

    Args:
        arguments: of the command line.
        live: serves the results while they are computed; None where nobody asks for it.

    Raises:
        RoadpercError: the log cannot be replayed.
    """
    time_range, (*sources, target) = time_range_of(arguments), arguments.logs
    with live or nullcontext():
        with frame_progress("replaying", not arguments.quiet) as progress:
            summary = replay(
                sources,
                target,
                config_of(arguments),
                overrides=parse_topic_options(arguments.topic),
                time_range=time_range,
                results_only=arguments.results_only,
                on_request=_requests(arguments),
                force=arguments.force,
                recover=arguments.recover,
                strict=arguments.strict,
                continued=arguments.continued,
                warm_up_s=arguments.warm_up or 0.0,
                checkpoint_every_s=arguments.checkpoint_every,
                resume=arguments.resume,
                progress=progress,
                opened=live.start if live else unwatched,
            )
        if not arguments.quiet:
            with optional_output():
                _print_summary(target, summary)
        if live:
            live.wait()


def _requests(arguments: argparse.Namespace) -> tuple[Request, ...]:
    """The pictures that the options ask for."""
    asked: dict[Request, bool] = {"overlay": arguments.overlay, "debug": arguments.debug}
    return tuple(request for request, wanted in asked.items() if wanted)


def _print_summary(target: Path, summary: ReplaySummary) -> None:
    for warning in summary.warnings:
        print_line(f"warning: {warning}")
    for note in (*summary.notes, *summary.throughout):
        print_line(f"note: {note}")
    for topic, number in summary.problems.items():
        print_line(f"warning: {number} messages on {topic} could not be read; they are copied, their frames go without")
    for role, number in summary.dropped.items():
        print_line(f"note: {number} messages of role {role} belong to no frame")
    rate = summary.frames / summary.seconds
    print_line(f"{summary.frames} frames in {summary.seconds:.1f} s ({rate:.1f} frames/s), log {summary.log_id}")
    print_line(
        f"wrote {target} ({summary.messages_out} messages), {sidecar_path(target, 'metrics').name}, "
        f"{sidecar_path(target, 'objects').name}"
    )
