"""Metrics tables that the arguments name (files, folders, globs, logs with results), and checks of their columns."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from roadperc_stream.errors import TableError
from roadperc_stream.model.finding import Finding, decoded_findings
from roadperc_stream.output.tables import arrow_schema, facts_in, sidecar_path
from roadperc_stream.schemas import record
from roadperc_stream.schemas.columns import EXTRA_COLUMNS, FrameMetrics
from roadperc_stream.system.files import METRICS_SUFFIX, OBJECTS_SUFFIX, TABLE_SUFFIX, real_path
from roadperc_stream.system.text import number, whole_number

_COMPLETE: Final = ("log_id", "frame", "stamp_ns", "total_ms")
"""Columns that have a finite value in every row."""
_WHOLE: Final = ("frame", "stamp_ns")
"""Columns of whole numbers, by which frames are found."""
_LARGEST: Final[Mapping[pl.DataType, float]] = {pl.Int64(): 2.0**63 - 1024, pl.Float64(): 1e100}
"""Largest number accepted in a column, by its type in replays; sums of squares of such numbers stay finite."""
_TEXTS: Final = (pl.String, pl.Categorical, pl.Enum)
_FACTS: Final = (
    *("config_digest", "version", "config", "options", "source", "log"),
    *(record.LOG_ID_KEY, record.CONTINUES_KEY),
)
"""Entries of a table's footer that become attributes of its run, under the same names."""


def collect(frame: pl.LazyFrame, source: str) -> pl.DataFrame:
    """The rows of a query on one table.

    The in-memory engine reads 10,000 rows in 25 ms, the streaming engine in 300 ms.

    Raises:
        TableError: the data of ``source`` cannot be read.
    """
    with reading(source):
        return frame.collect(engine="in-memory")


@contextmanager
def reading(source: str) -> Iterator[None]:
    """Turn polars' errors while it reads a table into a ``TableError`` that names the table."""
    try:
        yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        raise TableError(f"{source}: its data cannot be read: {first_line(error)}") from error


def _require_columns_as_written(path: Path) -> None:
    """Check the types, the largest numbers and the required values of the columns that a replay writes.

    The numbers come from the rows. The footer has minima and maxima too, but reading them from a damaged footer can end
    the process with an exception of the Parquet library.

    Raises:
        TableError: a column has another type, lacks values, or holds a number too large to compute with; or the data
            cannot be read.
    """
    rows = pl.scan_parquet(path, glob=False)
    with reading(str(path)):
        found = rows.collect_schema()
    for name, expected in written_columns().items():
        if name in found and not _fits(name, expected, found[name]):
            raise TableError(f"{path}: column {name} is of type {found[name]}, expected {expected}")
    largest = {name: _LARGEST[kind] for name, kind in written_columns().items() if name in found and kind in _LARGEST}
    finite = {name: pl.col(name).filter(pl.col(name).is_finite()) for name in largest if found[name] != pl.Null}
    values = collect(
        rows.select(
            *((pl.len() - finite.get(name, pl.col(name)).count()).alias(f"{name} without") for name in _COMPLETE),
            *(column.min().alias(f"{name} least") for name, column in finite.items()),
            *(column.max().alias(f"{name} most") for name, column in finite.items()),
        ),
        str(path),
    ).row(0, named=True)
    for name in _COMPLETE:
        if values[f"{name} without"]:
            raise TableError(f"{path}: is not a metrics table: column {name} has rows without a value")
    for name in finite:
        for value in (values[f"{name} least"], values[f"{name} most"]):
            if value is not None and abs(value) > largest[name]:
                raise TableError(f"{path}: column {name} holds {value:g}, expected {largest[name]:g} at most")


@cache
def written_columns() -> pl.Schema:
    """Names and types of the columns that a replay writes."""
    return pl.DataFrame(arrow_schema(FrameMetrics, EXTRA_COLUMNS).empty_table()).schema


def _fits(name: str, expected: pl.DataType, kind: pl.DataType) -> bool:
    """Whether a column of type ``kind`` can be read as ``expected``; a column without values has type null."""
    if kind == pl.Null:
        return name not in _COMPLETE
    if isinstance(expected, pl.List):
        inner, wanted = getattr(kind, "inner", None), expected.inner
        texts = _TEXTS if wanted == pl.String else ()
        return inner in (pl.Null, wanted, *texts) or (wanted.is_numeric() and inner is not None and inner.is_numeric())
    if expected == pl.String:
        return kind in _TEXTS
    if expected == pl.Boolean:
        return kind == pl.Boolean
    return kind.is_integer() or (kind.is_float() and name not in _WHOLE)


@dataclass(frozen=True)
class Run:
    """One metrics table, or several tables of continued replays: the frames of one log under one configuration.

    ``name`` is unique within a report. ``frames`` counts the frames in use, ``rows`` all rows of the table.
    ``config_digest``, ``version``, ``config`` (the configuration as TOML) and ``options`` (of its batch, as on the
    command line) identify the replay, ``source`` and ``log`` its input and its result. Each is empty if the file does
    not record it.

    ``log_id`` and ``continues`` are digests of this log and of the log it continues.
    The table starts at ``first_frame``. Frames from ``end_frame`` on are not used, because the run ``next_run``
    continues this one and repeats them, complete.

    ``within`` is the log and the configuration of the run's rows if its file holds rows of other runs too.
    ``dataset`` is the dataset of the run, as the user named it, and the name of its configuration there.

    ``findings`` are those of its replay, None if the table does not record them. ``mounting_height_m`` is the camera's
    height by the transforms of the log, None without transforms.

    If continued replays were joined, ``joined`` holds their runs in order, at least two. The other fields, except the
    counts and the name, are those of the first one.
    """

    name: str
    path: Path
    frames: int
    columns: frozenset[str]
    config_digest: str = ""
    version: str = ""
    config: str = ""
    options: str = ""
    source: str = ""
    log: str = ""
    log_id: str = ""
    continues: str = ""
    first_frame: int = 0
    end_frame: int | None = None
    next_run: str = ""
    rows: int = 0
    within: tuple[str, str] | None = None
    dataset: tuple[str, str] | None = None
    findings: tuple[Finding, ...] | None = None
    mounting_height_m: float | None = None
    joined: tuple["Run", ...] = ()

    @property
    def tables(self) -> tuple["Run", ...]:
        """One run for each metrics table."""
        return self.joined or (self,)

    def beside(self, suffix: str) -> Path:
        """The file beside the table with another suffix, such as ``.mcap`` for its log."""
        return self.path.with_name(self.path.name.removesuffix(METRICS_SUFFIX) + suffix)

    def table_of(self, frame: int) -> "Run":
        """The run of the metrics table that has a frame."""
        return next((table for table in reversed(self.tables) if table.first_frame <= frame), self)

    @property
    def objects(self) -> Path | None:
        """The table of objects beside the table or in its dataset; None without one, or if it holds other runs too."""
        path = self.beside(OBJECTS_SUFFIX)
        if self.dataset:
            path = self.path.parents[2].joinpath("objects", *self.path.parts[-2:])
        return path if path.is_file() and not self.within else None

    @property
    def source_name(self) -> str:
        """The tables' name in error messages."""
        more = len(self.tables) - 1
        return f"{self.path} and {number(more, 'more table')}" if more else str(self.path)

    @property
    def repeated_by(self) -> str:
        """Note that another run repeats all frames of this one."""
        return f"{self.next_run} repeats all its {self.rows} frames"

    @property
    def why_empty(self) -> str:
        """Reason why a run has no frames."""
        return f"{self.path}: {self.repeated_by if self.rows and self.next_run else 'no frames in this table'}"


def find_runs(arguments: Sequence[str]) -> tuple[Run, ...]:
    """The runs that the arguments name, each table once, in the order given; folders and globs alphabetically.

    Raises:
        TableError: an argument names no table, or a file is not a metrics table.
    """
    found = [path for argument in arguments for path in _tables(argument)]
    paths = list({real_path(path): path for path in found}.values())
    runs = [open_run(path, name) for path, name in zip(paths, distinct_names(paths), strict=True)]
    return tuple(_without_repeated_frames(run, runs) for run in runs)


def _without_repeated_frames(run: Run, runs: Iterable[Run]) -> Run:
    """The run without the frames that its continued replay repeats."""
    same = (run.log_id, run.config_digest)
    later = [other for other in runs if run.log_id and (other.continues, other.config_digest) == same]
    if not later:
        return run
    following = min(later, key=lambda other: other.first_frame)
    frames = min(max(following.first_frame - run.first_frame, 0), run.frames)
    return replace(run, frames=frames, end_frame=following.first_frame, next_run=following.name)


def open_run(path: Path, name: str) -> Run:
    """Read a table's footer and check its columns.

    Raises:
        TableError: the file cannot be read, is not Parquet, or is not a metrics table.
    """
    try:
        footer = pq.read_metadata(path)
        columns = footer.schema.to_arrow_schema().names
    except UnicodeDecodeError as error:
        raise TableError(f"{path}: has a column name that is not UTF-8 ({error.reason})") from error
    except pa.ArrowException as error:
        raise TableError(f"{path}: is not a Parquet file, or is truncated ({first_line(error)})") from error
    except OSError as error:
        raise TableError(f"{path}: {error.strerror or first_line(error)}") from error
    _require_columns(path, columns)
    _require_columns_as_written(path)
    facts = facts_in(footer.metadata)
    rows = footer.num_rows
    known: dict[str, Any] = {key: facts[key] for key in _FACTS if key in facts}
    first_frame = whole_number(facts.get(record.FIRST_FRAME_KEY, "")) or 0
    stored = facts.get(record.FINDINGS_KEY)
    findings = None if stored is None else decoded_findings(stored)
    known |= {"findings": findings, "mounting_height_m": _height(facts.get(record.MOUNTING_KEY, ""))}
    return Run(name, path, rows, frozenset(columns), **known, first_frame=first_frame, rows=rows)


def _height(text: str) -> float | None:
    """The number; None if the text is not one."""
    try:
        return float(text)
    except ValueError:
        return None


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """File names without suffix; where two are equal, with as many folders as needed to make them unique."""
    full = [real_path(path).with_name(path.name.removesuffix(METRICS_SUFFIX)).parts for path in paths]
    depths = [1] * len(full)
    while True:
        names = ["/".join(parts[-depth:]) for parts, depth in zip(full, depths, strict=True)]
        shared = Counter(names)
        rows = zip(names, depths, full, strict=True)
        grown = [min(depth + (shared[name] > 1), len(parts)) for name, depth, parts in rows]
        if grown == depths:
            return names
        depths = grown


def _tables(argument: str) -> list[Path]:
    path = Path(argument)
    if path.is_dir():
        return _in_folder(path)
    if path.suffix == ".mcap":
        table = sidecar_path(path, "metrics")
        if not table.exists():
            missing = f"no {table.name} beside it; roadperc-replay writes one beside its OUT.mcap"
            raise TableError(f"{path}: {missing if path.exists() else 'no such file'}")
        return [table]
    if path.exists():
        return [path]
    if any(sign in argument for sign in "*?["):
        return _in_glob(argument)
    raise TableError(f"{argument}: no such file or folder")


def _in_folder(folder: Path) -> list[Path]:
    paths = sorted(folder.rglob(f"*{METRICS_SUFFIX}"))
    if not paths:
        if any(folder.glob("date=*/")):
            raise TableError(f"{folder}: is part of a batch's dataset; pass the dataset's folder, {folder.parent}")
        raise TableError(f"{folder}: no *{METRICS_SUFFIX} in this folder or below; roadperc-replay writes them")
    return paths


def _in_glob(pattern: str) -> list[Path]:
    """The metrics tables among a glob's matches; logs and tables of detections are skipped."""
    path = Path(pattern)
    matches = sorted(Path(path.anchor).glob(str(path.relative_to(path.anchor))))
    files = [path for path in matches if path.suffix == TABLE_SUFFIX and not path.name.endswith(OBJECTS_SUFFIX)]
    below = [path for folder in matches if folder.is_dir() for path in sorted(folder.rglob(f"*{METRICS_SUFFIX}"))]
    if not files and not below:
        others = number(len(matches), "file") if matches else "no file"
        raise TableError(f"{pattern}: matches no metrics table ({others} of other kinds)")
    return [*files, *below]


def _require_columns(path: Path, columns: Iterable[str]) -> None:
    missing = next((name for name in written_columns() if name not in columns), None)
    if missing is None:
        return
    frames = f"{path.name.removesuffix(OBJECTS_SUFFIX)}{METRICS_SUFFIX}"
    hint = f"its frames are in {frames}" if path.name.endswith(OBJECTS_SUFFIX) else "replay the log again"
    raise TableError(f"{path}: is not a metrics table of this version: it has no column {missing}; {hint}")


def first_line(error: BaseException) -> str:
    """The first line of a library's error message."""
    if "expanded paths were empty" in str(error):
        return "no file matches"
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(". ")
