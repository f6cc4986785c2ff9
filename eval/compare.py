"""``roadperc-compare``: a run against a reference, field by field and metric by metric."""

import argparse
import sys
from pathlib import Path

from roadperc_stream import __version__
from roadperc_stream.cli.plumbing import run, telling
from roadperc_stream.cli.terminal import console_for
from roadperc_stream.errors import RoadpercError

from .comparison.comparing import Comparison, compare_runs
from .comparison.display import print_comparison
from .comparison.pairing import logged_runs, pair_runs
from .comparison.reference import Copy, carry_out, first_copies, is_new, require_updatable, update_copies
from .comparison.rules import Rules, allowance, tolerance

_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap base.mcap
  roadperc-replay logs/sample.mcap other.mcap --set surface.inlier_m=0.5
  roadperc-compare base.mcap other.mcap                    tables and, field by field, the messages of both logs
  roadperc-compare base.metrics.parquet other.metrics.parquet --allow surface_angle_error_deg=0.2 --allow 5%
  roadperc-compare reference/ runs/ --update-reference     folders: runs of the same log pair; reference/ is kept

exit code 0: no metric is worse than allowed, be the fields identical or not; 1: one is, or a run or frame of A is not
in B, or, with --exact, a field differs beyond its tolerance; or a stated error. 2: wrong usage.

Fields are the tables' columns and, where A and B are logs, those of the results, such as lanes.boundaries.offset_m.
Metrics are the errors against truth and the lanes' jitter (lane_left_error_m), the share of frames in which a column
has a value (lane_left_error_m.coverage) or a stage its best state (odometry_status.tracked, surface_source.depth,
lane_left_status.measured). Times are shown, and judged only where --allow names them: --allow total_ms=10%.
"""


class RegressionError(RoadpercError):
    """The candidate is worse than allowed, or differs where it must not."""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-compare``: print where two runs part, and whether the second is worse."""
    arguments = _parser().parse_args(argv)
    return run(lambda: _compare(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="roadperc-compare",
        description="Compare a run B with a reference A: the first difference of every field with both values, then\n"
        "for every metric the paired difference with its interval, marked better, worse or unchanged.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    inputs = "a metrics table (OUT.metrics.parquet), an OUT.mcap with its table beside it, or a folder of tables"
    parser.add_argument("reference", metavar="A", help=f"the reference: {inputs}")
    parser.add_argument("candidate", metavar="B", help="the candidate: the same")
    _add_rules(parser)
    parser.add_argument("--exact", action="store_true", help="a field that differs beyond its tolerance is exit code 1")
    parser.add_argument("--other-log", action="store_true", help="compare runs of two different logs by their stamps")
    parser.add_argument(
        "--update-reference",
        action="store_true",
        help="afterwards replace A's tables whose results differ by B's, and be content; A may be new",
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def _add_rules(parser: argparse.ArgumentParser) -> None:
    ignored, tolerated, allowed = (
        "leave out fields and metrics (glob)",
        "absolute difference of a field (glob) that counts as none",
        "how much worse a metric (glob) may be: in its unit, or N%% of A's mean; N%% alone is for all but times",
    )
    parser.add_argument("--ignore", metavar="NAME", action="append", default=[], help=ignored)
    parser.add_argument(
        "--tolerance", metavar="FIELD=VALUE", type=tolerance, action="append", default=[], help=tolerated
    )
    parser.add_argument("--allow", metavar="[METRIC=]VALUE", type=allowance, action="append", default=[], help=allowed)


def _compare(arguments: argparse.Namespace) -> None:
    candidate = logged_runs(arguments.candidate)
    if arguments.update_reference:
        require_updatable(arguments.reference)
        if is_new(arguments.reference):
            _update(first_copies(arguments.reference, candidate))
            return
    pairing = pair_runs(logged_runs(arguments.reference), candidate, arguments.other_log)
    rules = Rules(tuple(arguments.ignore), tuple(arguments.tolerance), tuple(arguments.allow))
    found = compare_runs(pairing, _logs(arguments), rules)
    with telling():
        print_comparison(console_for(sys.stdout), found)
    if arguments.update_reference:
        _update(update_copies(arguments.reference, pairing))
    else:
        _require_no_regression(found, arguments.exact)


def _logs(arguments: argparse.Namespace) -> tuple[Path, Path] | None:
    """Both logs, where logs were named."""
    reference, candidate = Path(arguments.reference), Path(arguments.candidate)
    return (reference, candidate) if reference.suffix == candidate.suffix == ".mcap" else None


def _update(copies: tuple[Copy, ...]) -> None:
    carry_out(copies)
    for copy in copies:
        print(f"reference: {copy.target} is now {copy.source}")
    if not copies:
        print("reference: nothing to replace, its results are the same")


def _require_no_regression(found: Comparison, exact: bool) -> None:
    if found.regressions:
        raise RegressionError(f"worse than the reference: {_listed(found.regressions)}")
    if exact and found.differences:
        raise RegressionError(f"differs from the reference: {_listed(found.differences)}")


def _listed(names: list[str], shown: int = 6) -> str:
    rest = len(names) - shown
    return ", ".join(names[:shown]) + (f" and {rest} more" if rest > 0 else "")
