"""Which files a run came from, as its table names them, and whether they are still there."""

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.core.files import METRICS_SUFFIX
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT

from ..runs import Run


@dataclass(frozen=True)
class Sources:
    """Input and output log of a table, None where it does not name them, and the digest of its configuration.

    Of a drive's part the frames from ``first_frame`` to before ``end_frame`` count.
    """

    source: Path | None
    log: Path | None
    config_digest: str = ""
    first_frame: int = 0
    end_frame: int | None = None

    def holds(self, frame: int) -> bool:
        """Whether a frame of the run is of this table."""
        return self.first_frame <= frame and (self.end_frame is None or frame < self.end_frame)

    @property
    def present_log(self) -> Path | None:
        """The log with results, if it is where the table says."""
        return self.log if self.log is not None and self.log.is_file() else None

    def is_replayed_again(self, log_path: Path) -> bool:
        """Whether the log holds another configuration than made the table: its results are then of another run.

        Raises:
            LogError: the log cannot be read.
        """
        stored = (a.data for a in log.summarise(log_path).attachments if a.name == CONFIG_ATTACHMENT)
        return bool(self.config_digest) and any(sha256(data).hexdigest() != self.config_digest for data in stored)


def sources_of(run: Run) -> tuple[Sources, ...]:
    """The files of each of a run's tables."""
    return tuple(_of_table(table) for table in run.tables)


def _of_table(run: Run) -> Sources:
    """What the table's footer says; a log next to the table counts where the named one is gone.

    A run's files are often moved together, from the machine that replayed to the one that reports.
    """
    source, named = (Path(path) if path else None for path in (run.source, run.log))
    neighbour = run.path.with_name(run.path.name.removesuffix(METRICS_SUFFIX) + ".mcap")
    moved = (named is None or not named.is_file()) and neighbour.is_file()
    return Sources(source, neighbour if moved else named, run.config_digest, run.first_frame, run.end_frame)
