"""Names the files that a replay writes, and checks that it may write them."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.errors import LogError, TargetError
from roadperc_stream.input.earlier_replay import is_result_log
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.topics import Request
from roadperc_stream.system.files import TABLE_SUFFIX, require_free


@dataclass(frozen=True)
class ReplayTarget:
    """The log that a replay writes, with the tables beside it.

    Args:
        path: the log. The tables beside it are ``NAME.metrics.parquet`` and ``NAME.objects.parquet``.
        results_only: leave the input's messages out.
        on_request: pictures to write with the results; their time counts as encoding.
        force: replace existing results, but never an input log; start over if a checkpoint is from another replay.
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
        """The log and both tables."""
        return self.path, self.metrics, self.objects

    @property
    def is_complete(self) -> bool:
        """Whether all files exist. The log gets its name last."""
        return all(path.exists() for path in self.files)

    def require_free(self, sources: Iterable[Path]) -> None:
        """Check that the files may be written; with ``force`` existing ones may be replaced.

        They must not replace ``sources``, the input.

        Raises:
            TargetError: a file must not be written.
        """
        for source in sources:
            require_free(self.path, force=self.force, source=source, suffix=".mcap")
        for table in (self.metrics, self.objects):
            require_free(table, force=self.force, suffix=TABLE_SUFFIX)

    def require_writable(self, sources: Collection[Path], continued: Path | None, *, resume: bool) -> None:
        """Check the output before the input is read.

        ``sources`` is the input, ``continued`` the result that the replay continues. With ``resume`` a finished output
        may exist.

        Raises:
            TargetError: a file must not be replaced.
        """
        replace(self, force=True).require_free(sources)
        if continued is not None and continued.exists() and self.path.exists() and self.path.samefile(continued):
            raise TargetError(f"{self.path} is the result that --continue names; choose another output")
        self._require_result(several=len(sources) > 1)
        if not resume:
            self.require_free(sources)

    def _require_result(self, *, several: bool) -> None:
        """Check that an existing log is a result. An input here may mean that the user forgot the output."""
        if not self.path.exists():
            return
        try:
            replaceable = is_result_log(*log.outline(self.path))
        except LogError:
            replaceable = not several
        if not replaceable:
            raise TargetError(
                f"refusing to overwrite {self.path}: it was not written by roadperc-replay. Is OUT.mcap missing?"
            )
