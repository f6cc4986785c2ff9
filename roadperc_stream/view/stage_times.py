"""How long each stage took: the log is the same bytes every time, so the times come from elsewhere."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Protocol

from roadperc_stream.output.tables import read_rows_around
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics

_TOTAL: Final = "total_ms"
_PARTS: Final = frozenset(TIME_COLUMNS) - {_TOTAL}
"""Tables of earlier versions lack some of them."""
TimesMs = Mapping[str, float]
"""Milliseconds by time column; stages that did not run are left out."""


class StageTimes(Protocol):
    """Knows the times of a log's frames, in any order."""

    def of(self, log_id: str, frame: int) -> TimesMs:
        """Those of a frame; empty where they are not known."""
        ...


class TableTimes:
    """Those in ``OUT.metrics.parquet``, of which a row group is held; where there is no such file, none."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._rows: dict[int, dict[str, Any]] = {}

    def of(self, log_id: str, frame: int) -> TimesMs:
        """Those of a frame; empty where the table has no such frame, or is another log's.

        Raises:
            TableError: the table cannot be read.
        """
        if frame not in self._rows:
            exists = self._path.exists()
            rows = read_rows_around(self._path, frame, ("log_id", _TOTAL), _PARTS) if exists else []
            self._rows = {frame: {}} | {row["frame"]: row for row in rows}
        row = self._rows[frame]
        return _known(row) if row.get("log_id") == log_id else {}


class ReplayTimes:
    """Those of a replay while it runs, some doubles a frame."""

    def __init__(self) -> None:
        self._times_ms: dict[tuple[str, int], tuple[float | None, ...]] = {}

    def note(self, row: FrameMetrics, times_ms: TimesMs) -> None:
        """Take a frame's times."""
        self._times_ms[row.log_id, row.frame] = tuple(times_ms.get(column) for column in TIME_COLUMNS)

    def of(self, log_id: str, frame: int) -> TimesMs:
        """Those of a frame; empty where it is not done."""
        return _known(dict(zip(TIME_COLUMNS, self._times_ms.get((log_id, frame), ()), strict=False)))


def _known(row: Mapping[str, float | None]) -> TimesMs:
    return {column: value for column in TIME_COLUMNS if (value := row.get(column)) is not None}
