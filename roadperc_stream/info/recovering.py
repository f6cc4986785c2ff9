"""Writes what can be read of a damaged log as a whole one, and says what was lost."""

import sys
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.core.files import require_free
from roadperc_stream.input.damage import warnings_of
from roadperc_stream.output.terminal import console_for, print_lines


def recover_log(source: Path, target: Path, *, force: bool) -> None:
    """Repair a log.

    Args:
        source: the log.
        target: the log to write.
        force: replace an existing ``target``.

    Raises:
        LogError: not one message can be read.
        TargetError: ``target`` cannot be written, or may not be.
    """
    require_free(target, force=force, source=source, suffix=".mcap")
    (file,) = log.received([source])
    salvage, recovery = log.write_repaired(file, target)
    console = console_for(sys.stdout)
    if salvage.whole:
        print_lines(console, f"note: {source}: whole, nothing was lost", unbroken=True)
    else:
        warnings = warnings_of(source, salvage.damages, recovery, salvage.first_ns)
        print_lines(console, *(f"warning: {warning}" for warning in warnings), unbroken=True)
    print_lines(console, f"wrote {target} ({recovery.saved} messages)", unbroken=True)
