"""Prints the report on runs or on a dataset, and writes its page and the files for other programs."""

import sys
from collections.abc import Sequence

from rich.console import Console

from roadperc_stream.output.terminal import console_for, print_lines

from ..dataset.place import dataset_at
from ..options import ReportOptions
from ..results import ResultFiles
from .dataset_report import DatasetReport
from .run_report import RunReport


def report(names: Sequence[str], options: ReportOptions, files: ResultFiles) -> None:
    """Print the figures of runs or of one dataset, and write the page and the files for other programs.

    Raises:
        RoadpercError: an argument names no run, no run has a frame, a column does not exist, or a file cannot be read
            or written.
    """
    console = console_for(sys.stdout)
    found = _found(names, options, console)
    if options.html is not None:
        found.write_page(options.html)  # first, because the reader of the text may close the pipe
    short = found.short() if files.paths or not options.full else None
    if short is not None:
        short.write(files)
    (short if short is not None and not options.full else found.full()).print(console)
    if options.html is not None:
        print_lines(console, "", f"page   {options.html}", unbroken=True)


def _found(names: Sequence[str], options: ReportOptions, console: Console) -> RunReport | DatasetReport:
    dataset = dataset_at(names[0])
    return RunReport(names, options, console) if dataset is None else DatasetReport(dataset, options, console)
