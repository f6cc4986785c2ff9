"""``roadperc-compare``: compare a run with a reference, by fields and metrics."""

import argparse

from roadperc_stream.cli.completers import RUNS, completed_by, files
from roadperc_stream.cli.plumbing import command_parser, parse, part, run

_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap base.mcap
  roadperc-replay logs/sample.mcap other.mcap --set surface.inlier_m=0.5
  roadperc-compare base.mcap other.mcap                    compare the tables, and the messages of both logs
  roadperc-compare base.metrics.parquet other.metrics.parquet --allow surface_angle_error_deg=0.2 --allow 5%
  roadperc-compare reference/ runs/ --update-reference     compare folders by log, then update reference/
  roadperc-compare dataset --config default --config lanes.hold_s=2    compare two configurations of a batch

exit codes:
  0  no metric is worse than allowed; fields may differ
  1  a metric is worse, a run or a frame of A is missing in B, an error occurred, or with --exact a field differs by
     more than its tolerance
  2  wrong usage

fields: the columns of the tables. If A and B are logs, also the fields of the result messages, such as
  lanes.boundaries.offset_m.
metrics:
  errors against truth and jitter of the lanes, such as lane_left_error_m
  the share of frames with a value, such as lane_left_error_m.coverage
  the share of frames in the best state of a stage: odometry_status.tracked, surface_source.depth,
  lane_left_status.measured
  Times are printed. They count for the verdict only with --allow, such as --allow total_ms=10%.
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-compare``: print the differences of two runs, and whether the second is worse."""
    parser = _parser()
    arguments = parse(parser, argv)
    _require_two(parser, arguments)
    comparing = part("eval.compare")
    return run(lambda: comparing.compare(arguments))


def _require_two(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Exit with code 2 if the arguments do not name two sides."""
    if arguments.new is not None:
        if arguments.config:
            parser.error("--config compares two configurations of the dataset A; remove B")
    elif part("eval.dataset.place").dataset_at(arguments.base) is None:
        parser.error(f"{arguments.base}: expected B, or the OUT_DIR of a batch as A")
    elif arguments.update_reference:
        parser.error("--update-reference needs A and B; it does not update the OUT_DIR of a batch")


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "compare",
        "Compare a run B with a reference A. Prints the difference of each metric with its confidence interval,\n"
        "the verdict (better, worse or unchanged), and the first differing frame of each field.",
        _EXAMPLE,
    )
    inputs = "OUT.metrics.parquet, an OUT.mcap with its table, or a folder of tables"
    base = parser.add_argument(
        "base", metavar="BASE", help=f"the base run: {inputs}; or the OUT_DIR of a batch, without B"
    )
    new = parser.add_argument("new", metavar="NEW", nargs="?", help=f"the new run: {inputs}")
    parser.add_argument(
        "--config",
        metavar="NAME",
        action="append",
        default=[],
        help="for the OUT_DIR of a batch: first the reference's configuration, then the candidate's. NAME is a name "
        "or its first digits, a setting such as lanes.hold_s=2, or default. If the dataset has two "
        "configurations, the older one is the default reference",
    )
    _add_rules(parser)
    parser.add_argument(
        "--exact",
        action="store_true",
        help="list every differing field; exit with 1 if a field differs by more than its tolerance",
    )
    parser.add_argument(
        "--other-log", action="store_true", help="compare runs of two different logs, frame by frame by their stamps"
    )
    parser.add_argument(
        "--update-reference",
        action="store_true",
        help="after the comparison replace the differing tables of A with those of B, and exit with 0",
    )
    for action in (base, new):
        completed_by(action, files(*RUNS))
    return parser


def _add_rules(parser: argparse.ArgumentParser) -> None:
    rules = part("eval.options")
    allowed = "allowed deterioration of the metrics that match a glob: in the metric's unit, or N%% of A's mean; "
    for option, metavar, kind, text in (
        ("--ignore", "NAME", str, "ignore fields and metrics that match this glob"),
        ("--tolerance", "FIELD=VALUE", rules.tolerance, "allowed absolute difference of the fields that match a glob"),
        ("--allow", "[METRIC=]VALUE", rules.allowance, f"{allowed}N%% alone applies to all metrics except times"),
    ):
        parser.add_argument(option, metavar=metavar, type=kind, action="append", default=[], help=text)
