"""Runs ``roadperc-replay``: makes source, target and options from the arguments, and prints a summary."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING

from roadperc_stream.chain.own_stage import OwnStages, own_stages
from roadperc_stream.cli.arguments import config_of, time_range_of
from roadperc_stream.cli.template import with_template
from roadperc_stream.input import ReplaySource
from roadperc_stream.loop import replay
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import Callbacks, ReplaySummary
from roadperc_stream.resume.checkpoint import CheckpointFolder
from roadperc_stream.resume.opening import ReplayOptions
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.schemas.topics import Request
from roadperc_stream.system.process import keep_freed_memory, optional_output
from roadperc_stream.system.progress import Progress, no_progress
from roadperc_stream.system.text import print_line
from roadperc_stream.system.threads import usable_cores

if TYPE_CHECKING:
    from roadperc_stream.view.live.serving import LiveReplay


Bar = Callable[[str, bool], AbstractContextManager[Progress]]
"""The type of ``output.terminal.frame_progress``."""


def replay_log(arguments: argparse.Namespace, live: "LiveReplay | None", bar: Bar | None) -> None:
    """Replay a log as the arguments say, and print a summary.

    Args:
        arguments: of the command line.
        live: serves the results during the replay; None without ``--live``.
        bar: shows the progress; None without a terminal, so that rich is not imported.

    Raises:
        RoadpercError: the log cannot be replayed.
    """
    keep_freed_memory()
    target = _target(arguments)
    cfg, own = own_stages(config_of(arguments))
    shown = nullcontext(no_progress) if bar is None else bar("replaying", True)
    source, options = _source(arguments), _options(arguments, own)
    with live or nullcontext():
        with _naming_resume(arguments, target), shown as progress:
            cfg = with_template(cfg, arguments.template, source)
            callbacks = Callbacks(progress, live.start, live.times.note) if live else Callbacks(progress)
            summary = replay(source, target, cfg, options, callbacks)
        if not arguments.quiet:
            with optional_output():
                _print_summary(target, summary)
        if live:
            live.wait()
    if arguments.verify:
        from roadperc_stream.eval.verify import verify

        with nullcontext(no_progress) if bar is None else bar("verifying", True) as progress:
            lines = verify(source, target, cfg, options, progress)
        for line in lines if not arguments.quiet else ():
            print_line(line)


@contextmanager
def _naming_resume(arguments: argparse.Namespace, target: ReplayTarget) -> Iterator[None]:
    """Add the hint on ``--resume`` to the message of an interrupted replay with a checkpoint."""
    try:
        yield
    except KeyboardInterrupt:
        if arguments.checkpoint_every and CheckpointFolder(target.path).holds_one:
            text = "interrupted; run the same command with --resume to continue from the last checkpoint"
            raise KeyboardInterrupt(text) from None
        raise


def _options(arguments: argparse.Namespace, own: OwnStages) -> ReplayOptions:
    return ReplayOptions(
        arguments.continued,
        arguments.warm_up or 0.0,
        arguments.checkpoint_every,
        arguments.resume,
        arguments.threads or usable_cores(),
        own,
    )


def _source(arguments: argparse.Namespace) -> ReplaySource:
    """The input: all files except the last."""
    topics = parse_topic_options(arguments.topic)
    return ReplaySource(arguments.logs[:-1], topics, time_range_of(arguments), arguments.recover, arguments.strict)


def _target(arguments: argparse.Namespace) -> ReplayTarget:
    """The output: the last file, with the requested pictures."""
    asked: dict[Request, bool] = {"overlay": arguments.overlay, "debug": arguments.debug}
    requests = tuple(request for request, wanted in asked.items() if wanted)
    return ReplayTarget(arguments.logs[-1], arguments.results_only, requests, arguments.force)


def _print_summary(target: ReplayTarget, summary: ReplaySummary) -> None:
    for remark in summary.remarks:
        print_line(remark)
    if not summary.is_new:
        print_line(f"{summary.frames} frames, log {summary.log_id}")
        return
    if summary.resumed_s is not None:
        before, end = f"{summary.frames_before} of {summary.frames} frames", f"{summary.resumed_s:.3f} s of the log"
        print_line(f"resumed: {before} were complete, up to {end}")
    computed = summary.frames - summary.frames_before
    rate = f"{summary.seconds:.1f} s ({summary.frames_per_s:.1f} frames/s)"
    print_line(f"{computed} frames in {rate}, log {summary.log_id}")
    print_line(f"wrote {target.path} ({summary.messages_out} messages), {target.metrics.name}, {target.objects.name}")
