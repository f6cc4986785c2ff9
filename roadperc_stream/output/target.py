"""What a replay writes, and whether it may be written."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from roadperc_stream.core.files import TABLE_SUFFIX, remove_dead_partials, require_free
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.topics import Request


@dataclass(frozen=True)
class ReplayTarget:
    """The log that a replay writes, with the tables beside it.

    Args:
        path: of the log; ``path.metrics.parquet`` and ``path.objects.parquet`` come beside it.
        results_only: leave the input's messages out.
        on_request: pictures to write beside the results; drawing them counts as encoding.
        force: replace what is there, but no recording, and start over where a checkpoint is of another replay.
    """

    path: Path
    results_only: bool = False
    on_request: Collection[Request] = ()
    force: bool = False

    @property
    def metrics(self) -> Path:
        """The table of frames."""
        return sidecar_path(self.path, "metrics")

    @property
    def objects(self) -> Path:
        """The table of objects."""
        return sidecar_path(self.path, "objects")

    @property
    def files(self) -> tuple[Path, ...]:
        """All that is written."""
        return self.path, self.metrics, self.objects

    @property
    def is_complete(self) -> bool:
        """Whether all of them are there: the log is the last one that gets its name."""
        return all(path.exists() for path in self.files)

    def require_free(self, sources: Iterable[Path], *, force: bool) -> None:
        """Check that the files may be written.

        Args:
            sources: the input, which they must not replace.
            force: existing ones may be replaced.

        Raises:
            TargetError: one may not.
        """
        for source in sources:
            require_free(self.path, force=force, source=source, suffix=".mcap")
        for table in (self.metrics, self.objects):
            require_free(table, force=force, suffix=TABLE_SUFFIX)

    def remove_dead_partials(self) -> None:
        """Remove what earlier replays that were killed left unfinished under hidden names."""
        for path in self.files:
            remove_dead_partials(path)
