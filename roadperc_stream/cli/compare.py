"""``roadperc-compare``: compare a new run with a base run, by metrics and fields."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from roadperc_stream.cli.arguments import result_files_of
from roadperc_stream.cli.completers import RUNS, files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_result_files, command_parser, parse

if TYPE_CHECKING:
    from roadperc_stream.eval.compare.compare import CompareOptions
    from roadperc_stream.eval.options import Amount

_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap base.mcap
  roadperc-replay logs/sample.mcap other.mcap --set surface.inlier_m=0.5
  roadperc-compare base.mcap other.mcap                    compare the tables, and the messages of both logs
  roadperc-compare base.metrics.parquet other.metrics.parquet --allow surface_angle_error_deg=0.2 --allow 5%
  roadperc-compare reference/ runs/ --update-reference     compare folders by log, then update reference/
  roadperc-compare dataset --base-config default --new-config lanes.hold_s=2    two configurations of a batch
  roadperc-compare reference/ runs/ --junit compare.xml --markdown "$GITHUB_STEP_SUMMARY"
  roadperc-compare reference/ runs/ --markdown comment.md --pictures pictures    with the worst frames of both runs

exit codes:
  0  no metric is worse than allowed; fields may differ
  1  a metric is worse, NEW lacks a run or a frame of BASE, or with --exact a field differs by more than its tolerance
  2  wrong usage
  3  an error: a file cannot be read, or the runs do not belong together

metrics:
  errors against truth and jitter of the lanes, such as lane_left_error_m
  the share of frames with a value, such as lane_left_error_m.coverage
  the share of frames in the best state of a stage: odometry_status.tracked, surface_source.depth,
  lane_left_status.measured
  times, only with --times or if --allow names them, such as --allow total_ms=10%
fields: the columns of the tables. If BASE and NEW are logs, also the fields of the result messages, such as
  lanes.boundaries.offset_m.
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-compare``: print what became worse or better, and where."""
    parser = _parser()
    arguments = parse(parser, argv)
    _require_two(parser, arguments)
    from roadperc_stream.eval.compare.compare import compare

    sides, options = (arguments.base, arguments.new), _options(arguments)
    return run(lambda: compare(*sides, options, result_files_of(arguments)), "compare")


def _options(arguments: argparse.Namespace) -> "CompareOptions":
    from roadperc_stream.eval.compare.compare import CompareOptions
    from roadperc_stream.eval.options import Rules

    amounts = tuple(arguments.tolerance), tuple(arguments.allow)
    return CompareOptions(
        (arguments.base_config, arguments.new_config),
        Rules(tuple(arguments.ignore), *amounts, arguments.times),
        arguments.criteria,
        arguments.pictures,
        full=arguments.full,
        exact=arguments.exact,
        other_log=arguments.other_log,
        update_reference=arguments.update_reference,
    )


def _require_two(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Exit with code 2 if the arguments do not name two sides."""
    from roadperc_stream.eval.dataset.place import dataset_at

    if arguments.new is None and dataset_at(arguments.base) is None:
        parser.error(f"{arguments.base}: expected NEW, or the OUT_DIR of a batch as BASE")
    for side, argument in (("base", arguments.base), ("new", arguments.new or arguments.base)):
        if getattr(arguments, f"{side}_config") and dataset_at(argument) is None:
            parser.error(f"--{side}-config needs the OUT_DIR of a batch, found {argument}")
    if arguments.update_reference and dataset_at(arguments.base) is not None:
        parser.error("--update-reference needs BASE and NEW; it does not update the OUT_DIR of a batch")


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "compare",
        "Compare a new run with a base run. Prints the verdict, the metrics that became worse or better with the\n"
        "interval of the difference, and the command that shows the frame that became worse by most.",
        _EXAMPLE,
    )
    inputs = "OUT.metrics.parquet, an OUT.mcap with its table, a folder of tables, or the OUT_DIR of a batch"
    add(parser, "base", metavar="BASE", help=f"the base run: {inputs}", completer=files(*RUNS))
    new = "the new run, likewise; without it, BASE is a batch with both"
    add(parser, "new", metavar="NEW", nargs="?", help=new, completer=files(*RUNS))
    name = "a name or its first digits, a setting such as lanes.hold_s=2, or default"
    base_config = f"for the OUT_DIR of a batch: the base's configuration, {name}"
    add(parser, "--base-config", metavar="NAME", help=base_config)
    new_config = "the new configuration; in a dataset of two configurations the older one is the base by default"
    add(parser, "--new-config", metavar="NAME", help=new_config)
    _add_rules(parser)
    criteria = "smallest relevant effects and limits of metrics"
    add(parser, "--criteria", metavar="FILE.toml", type=Path, help=criteria, completer=files(".toml"))
    for option, text in (
        ("--times", "judge times; the machine and its load must be the same"),
        ("--full", "print all findings, the table of every metric, and the first fields"),
        ("--exact", "list every differing field; exit with 1 if a field differs by more than its tolerance"),
        ("--other-log", "compare runs of two different logs, frame by frame by their stamps"),
        (
            "--update-reference",
            "after the comparison replace the differing tables of BASE with those of NEW, and exit with 0",
        ),
    ):
        add(parser, option, action="store_true", help=text)
    results = add_result_files(parser)
    pictures = "draw the three worst frames, base left and new right, into a folder; the Markdown shows them"
    add(results, "--pictures", metavar="DIR", type=Path, help=pictures)
    return parser


def _add_rules(parser: argparse.ArgumentParser) -> None:
    allowed = (
        "allowed deterioration of the metrics that match a glob: in the metric's unit, or N%% of the base's mean; "
    )
    for option, metavar, kind, text in (
        ("--ignore", "NAME", str, "ignore fields and metrics that match this glob"),
        ("--tolerance", "FIELD=VALUE", tolerance, "allowed absolute difference of the fields that match a glob"),
        ("--allow", "[METRIC=]VALUE", allowance, f"{allowed}N%% alone applies to all metrics except times"),
    ):
        add(parser, option, metavar=metavar, type=kind, action="append", default=[], help=text)


def tolerance(text: str) -> "Amount":
    """Parse ``FIELD=VALUE``."""
    from roadperc_stream.eval.options import Amount

    pattern, separator, number = text.rpartition("=")
    if not separator or not pattern:
        raise argparse.ArgumentTypeError(f"{text}: expected FIELD=VALUE, such as lane_left_offset_m=0.001")
    return Amount(pattern, _positive(text, number))


def allowance(text: str) -> "Amount":
    """Parse ``METRIC=VALUE``, ``METRIC=N%`` or ``N%``."""
    from roadperc_stream.eval.options import EVERYTHING, Amount

    pattern, _, number = text.rpartition("=")
    if number.endswith("%"):
        return Amount(pattern or EVERYTHING, _positive(text, number[:-1]) / 100, relative=True)
    if not pattern:
        raise argparse.ArgumentTypeError(f"{text}: expected METRIC=VALUE, METRIC=N% or N%")
    return Amount(pattern, _positive(text, number))


def _positive(text: str, number: str) -> float:
    try:
        value = float(number)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: {number!r} is not a number") from error
    if not math.isfinite(value) or value < 0:
        raise argparse.ArgumentTypeError(f"{text}: expected a number of 0 or more")
    return value
