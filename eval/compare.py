"""A run against a reference, field by field and metric by metric."""

import argparse
import sys
from pathlib import Path

from roadperc_stream.core.process import optional_output
from roadperc_stream.core.text import print_line
from roadperc_stream.errors import RegressionError
from roadperc_stream.output.terminal import console_for

from .comparison.comparing import Comparison, compare_runs
from .comparison.display import print_comparison
from .comparison.pairing import Pairing, logged_runs, pair_runs
from .comparison.reference import Copy, carry_out, first_copies, is_new, require_updatable, update_copies
from .comparison.rules import Rules
from .dataset.copying import in_a_folder
from .dataset.pairs import runs_of_configs
from .dataset.place import Dataset
from .names import listed


def compare(arguments: argparse.Namespace) -> None:
    """Print where two runs part, and whether the second is worse.

    Raises:
        RegressionError: it is, or a field differs where none may.
        RoadpercError: the runs cannot be read, or do not belong together.
    """
    if arguments.candidate is None:
        _compare_configurations(arguments)
        return
    candidate = logged_runs(arguments.candidate)
    if arguments.update_reference:
        require_updatable(arguments.reference)
        if is_new(arguments.reference):
            _update(first_copies(arguments.reference, candidate))
            return
    pairing = pair_runs(logged_runs(arguments.reference), candidate, arguments.other_log)
    found = _compared(pairing, _logs(arguments), arguments)
    if arguments.update_reference:
        _update(update_copies(arguments.reference, pairing))
    else:
        _require_no_regression(found, arguments.exact)


def _compare_configurations(arguments: argparse.Namespace) -> None:
    with in_a_folder(Dataset(arguments.reference)) as dataset:
        reference, candidate = runs_of_configs(dataset, arguments.config)
        found = _compared(pair_runs(reference, candidate, arguments.other_log), None, arguments)
    _require_no_regression(found, arguments.exact)


def _compared(pairing: Pairing, logs: tuple[Path, Path] | None, arguments: argparse.Namespace) -> Comparison:
    """The comparison, printed."""
    rules = Rules(tuple(arguments.ignore), tuple(arguments.tolerance), tuple(arguments.allow))
    found = compare_runs(pairing, logs, rules)
    with optional_output():
        print_comparison(console_for(sys.stdout), found, all_fields=arguments.exact)
    return found


def _logs(arguments: argparse.Namespace) -> tuple[Path, Path] | None:
    """Both logs, where logs were named."""
    reference, candidate = Path(arguments.reference), Path(arguments.candidate)
    return (reference, candidate) if reference.suffix == candidate.suffix == ".mcap" else None


def _update(copies: tuple[Copy, ...]) -> None:
    carry_out(copies)
    for copy in copies:
        print_line(f"reference: {copy.target} is now {copy.source}")
    if not copies:
        print("reference: nothing to replace, its results are the same")


def _require_no_regression(found: Comparison, exact: bool) -> None:
    if found.regressions:
        raise RegressionError(f"worse than the reference: {listed(found.regressions)}")
    if exact and found.differences:
        raise RegressionError(f"differs from the reference: {listed(found.differences)}")
