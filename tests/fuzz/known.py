"""Faults that are known and not yet mended: the one place that names them.

A corpus entry named in ``CORPUS`` must fail, so that the line is removed with the fault. A fault of a drawn case that
one of ``FAULTS`` is found in is counted as known and fails nothing.
"""

CORPUS: dict[str, str] = {}
FAULTS: tuple[str, ...] = ()


def is_known(fault: str) -> bool:
    """Whether a drawn case may have this fault for now."""
    return any(part in fault for part in FAULTS)
