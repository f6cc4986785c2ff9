"""Which files a run came from, as its table names them, and whether they are still there."""

from dataclasses import dataclass
from pathlib import Path

import pyarrow.parquet as pq

from ..runs import SUFFIX, Run


@dataclass(frozen=True)
class Sources:
    """Input and output log of a run; None where the table does not name them."""

    source: Path | None
    log: Path | None

    @property
    def present_log(self) -> Path | None:
        """The log with results, if it is where the table says."""
        return self.log if self.log is not None and self.log.is_file() else None


def sources_of(run: Run) -> Sources:
    """What the table's footer says; a log that lies beside the table counts where the named one is gone.

    A run's files are often moved together, from the machine that replayed to the one that reports.
    """
    facts = pq.read_metadata(run.path).metadata or {}
    source, log = (_path(facts.get(key, b"")) for key in (b"roadperc.source", b"roadperc.log"))
    beside = run.path.with_name(run.path.name.removesuffix(SUFFIX) + ".mcap")
    moved = (log is None or not log.is_file()) and beside.is_file()
    return Sources(source, beside if moved else log)


def _path(stored: bytes) -> Path | None:
    return Path(stored.decode("utf-8", "surrogateescape")) if stored else None
