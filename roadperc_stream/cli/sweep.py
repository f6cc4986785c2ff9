"""``roadperc-sweep``: replay logs under every combination of settings, and print the best setting per metric."""

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from roadperc_stream.cli.arguments import result_files_of, time_range_of
from roadperc_stream.cli.completers import LOGS, files, varied_settings, words
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import REPLAY, add, add_result_files, add_shared, command_parser, parse
from roadperc_stream.cli.values import whole_number
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.system.files import real_path

if TYPE_CHECKING:
    from roadperc_stream.eval.sweep.sweep import SweepOptions

_EXAMPLE = """\
example:
  roadperc-sweep logs/sample.mcap --vary lanes.fit_strip_m=0.2,0.3,0.5 --vary surface.inlier_m=0.03,0.05
  roadperc-sweep logs/sample.mcap --degrade fog=1,3,5 --degrade frame_drop=1,3,5 --out robustness

The first line replays the sample under all six combinations and writes a metrics table for each below sweep/, with
the settings as columns. Read them with pl.scan_parquet("sweep/**/*.parquet") or roadperc-report sweep/.
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-sweep``: replay logs under every combination of settings, or with corruptions."""
    parser = _parser()
    arguments = parse(parser, argv)
    for option in ("vary", "degrade"):
        keys = [key for key, _ in getattr(arguments, option)]
        if twice := [key for key in keys if keys.count(key) > 1]:
            parser.error(f"argument --{option}: {twice[0]} is varied twice")
    if not (arguments.vary or arguments.degrade) or (arguments.vary and arguments.degrade):
        parser.error("expected either --vary or --degrade")
    if arguments.baseline is not None and not arguments.degrade:
        parser.error("--baseline needs --degrade")
    logs = [real_path(path) for path in arguments.logs]
    for path in arguments.logs:
        if logs.count(real_path(path)) > 1:
            parser.error(f"argument IN.mcap: {path} is given twice")
    from roadperc_stream.eval.sweep.sweep import sweep

    return run(lambda: sweep(arguments.logs, _options(arguments), result_files_of(arguments)))


def _options(arguments: argparse.Namespace) -> "SweepOptions":
    from roadperc_stream.eval.sweep.sweep import SweepOptions

    return SweepOptions(
        arguments.out,
        dict(arguments.vary),
        dict(arguments.degrade),
        arguments.config,
        arguments.set,
        parse_topic_options(arguments.topic),
        time_range_of(arguments),
        arguments.seed,
        arguments.baseline,
        arguments.jobs,
        arguments.force,
    )


def _parser() -> argparse.ArgumentParser:
    from roadperc_stream.tools.corruptions.levels import LEVELS, swept

    parser = command_parser(
        "sweep",
        "Replay logs under every combination of some settings, or with corruptions, write the metrics to one dataset,\n"
        "and print the best setting for each metric, or its values by severity.",
        _EXAMPLE,
    )
    add(parser, "logs", metavar="IN.mcap", type=Path, nargs="+", help="the logs to replay", completer=files(*LOGS))
    add(
        parser,
        "--vary",
        metavar="KEY=A,B,...",
        type=varied,
        action="append",
        default=[],
        help="a setting and its values; repeat the option for combinations of settings",
        completer=varied_settings,
    )
    add(
        parser,
        "--degrade",
        metavar="NAME=A,B,...",
        type=swept,
        action="append",
        default=[],
        help="a corruption of roadperc-degrade and its severities, instead of settings; the option can be repeated",
        completer=words(f"{name}=" for name in LEVELS),
    )
    baseline = "result of the same --degrade under other settings, for mCE"
    add(parser, "--baseline", metavar="DIR", type=Path, help=baseline, completer=files())
    out = "folder of the dataset (default: sweep)"
    add(parser, "--out", metavar="DIR", type=Path, default=Path("sweep"), help=out, completer=files())
    jobs = "run N replays at a time (default: one per processor)"
    add(parser, "--jobs", metavar="N", type=whole_number, default=os.cpu_count() or 1, help=jobs)
    seed = "seed of the corruptions (default: 0)"
    force = "replace DIR if it is the result of an earlier sweep"
    add_shared(parser, *REPLAY, seed=seed, force=force)
    add_result_files(parser)
    return parser


def varied(text: str) -> tuple[str, tuple[str, ...]]:
    """Parse an argument such as ``lanes.fit_strip_m=0.2,0.3,0.5``.

    Raises:
        ArgumentTypeError: it has another form, or gives a value twice.
    """
    from roadperc_stream.eval.options import number_or_text

    key, _, values = text.partition("=")
    texts = tuple(value.strip() for value in values.split(","))
    if not key.strip() or not all(texts):
        raise argparse.ArgumentTypeError(f"{text}: expected KEY=VALUE,VALUE,... such as lanes.fit_strip_m=0.2,0.3,0.5")
    if len({number_or_text(value) for value in texts}) < len(texts):
        raise argparse.ArgumentTypeError(f"{text}: contains a value twice")
    return key.strip(), texts
