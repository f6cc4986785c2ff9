"""``roadperc-compare``: a run against a reference, field by field and metric by metric."""

import argparse

from roadperc_stream.cli.completers import RUNS, completed_by, files
from roadperc_stream.cli.plumbing import command_parser, parse, part, run

_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap base.mcap
  roadperc-replay logs/sample.mcap other.mcap --set surface.inlier_m=0.5
  roadperc-compare base.mcap other.mcap                    tables and, field by field, the messages of both logs
  roadperc-compare base.metrics.parquet other.metrics.parquet --allow surface_angle_error_deg=0.2 --allow 5%
  roadperc-compare reference/ runs/ --update-reference     folders: runs of the same log pair; reference/ is kept
  roadperc-compare dataset --config default --config lanes.hold_s=2    two configurations of a batch, log by log

exit code 0: no metric is worse than allowed, whether or not fields differ; 1: a metric is worse, a run or frame of A is
not in B, with --exact a field differs beyond its tolerance, or an error occurred; 2: wrong usage.

Fields are the tables' columns and, where A and B are logs, those of the results, such as lanes.boundaries.offset_m.
Metrics are the errors against truth and the lanes' jitter (lane_left_error_m), the share of frames in which a column
has a value (lane_left_error_m.coverage) or a stage its best state (odometry_status.tracked, surface_source.depth,
lane_left_status.measured). Times are shown, and judged only where --allow names them: --allow total_ms=10%.
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-compare``: print where two runs part, and whether the second is worse."""
    parser = _parser()
    arguments = parse(parser, argv)
    _require_two(parser, arguments)
    comparing = part("eval.compare")
    return run(lambda: comparing.compare(arguments))


def _require_two(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """End with exit code 2 where arguments do not name two sides."""
    if arguments.candidate is not None:
        if arguments.config:
            parser.error("--config: is for two configurations of one batch's OUT_DIR; expected no B")
    elif part("eval.dataset.place").dataset_at(arguments.reference) is None:
        parser.error(f"{arguments.reference}: is no OUT_DIR of a batch; expected B to compare it with")
    elif arguments.update_reference:
        parser.error("--update-reference: expected A and B; a batch's OUT_DIR is no reference to be replaced")


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "compare",
        "Compare a run B with a reference A: for every metric the paired difference with its interval, marked\n"
        "better, worse or unchanged, and the verdict; then the fields that differ, each at its first frame.",
        _EXAMPLE,
    )
    inputs = "a metrics table (OUT.metrics.parquet), an OUT.mcap with its table next to it, or a folder of tables"
    reference = parser.add_argument("reference", metavar="A", help=f"the reference: {inputs}")
    candidate = parser.add_argument(
        "candidate", metavar="B", nargs="?", help="the candidate: the same; not where A is the OUT_DIR of a batch"
    )
    parser.add_argument(
        "--config",
        metavar="NAME",
        action="append",
        default=[],
        help="where A is the OUT_DIR of a batch, twice: the reference's configuration and the candidate's, by name, "
        "first digits of it, or a setting such as lanes.hold_s=2, or default; of two, the older first if not given",
    )
    _add_rules(parser)
    parser.add_argument(
        "--exact", action="store_true", help="list every field that differs; one beyond its tolerance is exit code 1"
    )
    parser.add_argument("--other-log", action="store_true", help="compare runs of two different logs by their stamps")
    parser.add_argument(
        "--update-reference",
        action="store_true",
        help="then replace A's tables that differ by B's and exit with 0; A need not exist",
    )
    for action in (reference, candidate):
        completed_by(action, files(*RUNS))
    return parser


def _add_rules(parser: argparse.ArgumentParser) -> None:
    rules = part("eval.options")
    ignored, tolerated, allowed = (
        "leave out fields and metrics (glob)",
        "largest absolute difference of a field (glob) that counts as equal",
        "how much worse a metric (glob) may be: in its unit, or N%% of A's mean; N%% alone is for all but times",
    )
    parser.add_argument("--ignore", metavar="NAME", action="append", default=[], help=ignored)
    parser.add_argument(
        "--tolerance", metavar="FIELD=VALUE", type=rules.tolerance, action="append", default=[], help=tolerated
    )
    parser.add_argument(
        "--allow", metavar="[METRIC=]VALUE", type=rules.allowance, action="append", default=[], help=allowed
    )
