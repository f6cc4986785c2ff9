"""Frames that fulfil an SQL condition, and the events that they form: frames of one log that are close in time."""

import re
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.schemas.columns import FrameMetrics, columns_of
from roadperc_stream.system.time import NS_PER_S, ns_to_seconds, seconds_to_ns

from ..dataset.keys import LOG, LogKey
from ..dataset.reading import reading_files
from ..expressions import on_empty_rows, parsed, similar
from ..runs import Run
from ..scan import SEGMENT

OBJECTS: Final = "objects."
"""Prefix of the columns of objects in a condition."""
_IN_SQL: Final = re.compile(r"""('(?:[^']|'')*')|(?<!")\bobjects\.(?:"(\w+)"|(\w+))""")
"""A text, or a column of objects."""
_FRAME: Final = (*LOG, "frame")
_PLACES: Final = ("frame", "stamp_ns", SEGMENT)
"""Columns of numbers that are no measurement."""
_BETTER: Final = {name: column.better for name, column in columns_of(FrameMetrics).items()}


@dataclass(frozen=True)
class Event:
    """Frames of a log that fulfil a condition, close in time.

    ``frames`` is their number. ``peak`` is None if no frame has a value; then ``peak_frame`` is the first frame.
    ``command`` shows that frame. ``clip`` is the path of the excerpt to write, None without excerpts.
    """

    log: str
    log_id: str
    config: str
    first_frame: int
    last_frame: int
    frames: int
    first_ns: int
    last_ns: int
    peak: float | None
    peak_frame: int
    command: str
    clip: str | None

    @property
    def key(self) -> LogKey:
        """The log and the configuration."""
        return self.log_id, self.config

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return ns_to_seconds(self.last_ns - self.first_ns)


@dataclass(frozen=True)
class Clips:
    """Where excerpts go, and ``topics`` ROLE=/TOPIC for a log that was not kept and is replayed."""

    folder: Path
    topics: Sequence[str] = ()
    force: bool = False


@dataclass(frozen=True)
class Logs:
    """The logs to search: their tables, and how to name a log, to show a frame of it, and to open its runs.

    ``frames`` and ``objects`` scan some of the columns, or all columns for None. All rows have ``LOG`` and ``frame``.
    ``objects`` is None without tables of objects. ``files`` are the tables of the frames. ``absent`` are the logs and
    configurations whose files other logs have replaced.
    """

    frames: Callable[[Sequence[str] | None], pl.LazyFrame]
    objects: Callable[[Sequence[str] | None], pl.LazyFrame] | None
    files: Sequence[str]
    absent: pl.DataFrame
    name: Callable[[LogKey], str]
    command: Callable[[LogKey, int], str]
    runs: Callable[[Sequence[LogKey], ExitStack], dict[LogKey, Run]]

    def schema(self) -> dict[str, pl.DataType]:
        """The columns of the frames, and those of the objects with ``OBJECTS`` before the name."""
        of_objects = self.objects(None).collect_schema() if self.objects else {}
        return {**self.frames(None).collect_schema(), **{f"{OBJECTS}{name}": k for name, k in of_objects.items()}}


@dataclass(frozen=True)
class Condition:
    """A condition on a frame, or on a frame and one of its objects.

    ``peak`` is the column whose worst value is the peak of an event, empty without one; the worst value is the lowest
    one if ``lowest``, else the one with the largest absolute value.
    """

    rule: pl.Expr
    peak: str
    lowest: bool


def condition_of(text: str, peak: str, schema: dict[str, pl.DataType]) -> Condition:
    """A condition in SQL; without a ``peak`` its first column of numbers.

    The worst value is the lowest one if high values are better, or if the condition asks for values below a limit.

    Raises:
        TableError: the text is not a condition, or a column does not exist.
    """
    try:
        rule = parsed(_IN_SQL.sub(lambda found: found[1] or f'"{OBJECTS}{found[2] or found[3]}"', text))
    except ValueError as error:
        example = "\"time_to_impact_s < 2 and lane_change <> 'none'\""
        raise TableError(f"{text}: is not a polars SQL condition ({error}); expected one such as {example}") from error
    names = rule.meta.root_names()
    for name in (*names, *([peak] if peak else [])):
        if name not in schema:
            raise TableError(f"{text}: no column {name} of the tables; {similar(text, name, schema)}")
    _require_condition(text, rule, schema)
    if peak and not schema[peak].is_numeric():
        raise TableError(f"--peak {peak}: is of type {schema[peak]}, expected numbers")
    peak = peak or next((name for name in names if schema[name].is_numeric() and name not in _PLACES), "")
    below = re.search(rf"(?<![\w.]){re.escape(peak)}\s*<(?!>)", text) if peak else None
    return Condition(rule, peak, below is not None or _BETTER.get(peak) == "high")


def _require_condition(text: str, rule: pl.Expr, schema: dict[str, pl.DataType]) -> None:
    try:
        found = on_empty_rows(rule, schema)
    except ValueError as error:
        raise TableError(f"{text}: cannot be computed from the tables' columns: {error}") from error
    if found.dtype != pl.Boolean or found.len() == 1:
        kind = "one value for all rows" if found.len() == 1 else f"of type {found.dtype}"
        quotes = f", such as {text} > 2; put it in quotes, because a shell reads > as a file" if text in schema else ""
        raise TableError(f"{text}: is {kind}, expected a condition on columns{quotes}")


def matches(logs: Logs, condition: Condition, schema: dict[str, pl.DataType]) -> pl.DataFrame:
    """The frames that fulfil a condition, with ``LOG``, ``SEGMENT``, ``stamp_ns``, and the ``value`` of the peak.

    A condition on objects is joined by log and frame: a row for each object with which the frame fulfils it. A frame
    without objects has nulls in their columns.

    Raises:
        TableError: a table cannot be read, or a frame has no log, configuration, number or stamp.
    """
    wanted = {*LOG, *_PLACES, condition.peak, *condition.rule.meta.root_names()}
    own = [name for name in schema if name in wanted and not name.startswith(OBJECTS)]
    joined = [name.removeprefix(OBJECTS) for name in wanted if name.startswith(OBJECTS)]
    rows = logs.frames(own).select(own)
    if joined and logs.objects:
        named = [pl.col(name).alias(f"{OBJECTS}{name}") for name in joined]
        rows = rows.join(logs.objects((*_FRAME, *joined)).select(*_FRAME, *named), on=_FRAME, how="left")
    value = (pl.col(condition.peak) if condition.peak else pl.lit(None)).cast(pl.Float64).alias("value")
    found = rows.filter(condition.rule).select(*LOG, SEGMENT, "frame", "stamp_ns", value)
    with reading_files(logs.files):
        table = found.collect(engine="streaming")
    if nameless := [name for name in (*LOG, "frame", "stamp_ns") if table[name].null_count()]:
        raise TableError(f"{logs.files[0]} or another table: has rows without {nameless[0]}; replay the log again")
    return table


def events_of(found: pl.DataFrame, gap_s: float, least_s: float, *, lowest: bool) -> pl.DataFrame:
    """The events that frames from ``matches`` form, the worst peak first.

    Frames of one segment of a log that are less than ``gap_s`` apart are one event. Events shorter than ``least_s``,
    from the first frame to the last, are left out.

    Returns:
        ``LOG``, ``first_frame``, ``last_frame``, ``frames`` (their number), ``first_ns``, ``last_ns``, ``peak`` (null
        without a value) and ``peak_frame``, by default the first frame.
    """
    log = *LOG, SEGMENT
    begins = pl.any_horizontal(pl.col(name) != pl.col(name).shift() for name in log)
    begins |= pl.col("stamp_ns").diff() >= max(seconds_to_ns(gap_s), 1)
    value = pl.when(pl.col("value").is_finite()).then(pl.col("value"))
    badness = (-value if lowest else value.abs()).fill_null(float("-inf"))
    worst = badness.arg_max()
    events = (
        found.sort(*log, "stamp_ns", "frame")
        .group_by(begins.fill_null(value=True).cum_sum().alias("event"), maintain_order=True)
        .agg(
            pl.first(*LOG),
            pl.first("frame").alias("first_frame"),
            pl.last("frame").alias("last_frame"),
            pl.n_unique("frame").alias("frames"),
            pl.first("stamp_ns").alias("first_ns"),
            pl.last("stamp_ns").alias("last_ns"),
            value.get(worst).alias("peak"),
            pl.col("frame").get(worst).alias("peak_frame"),
            badness.max().alias("badness"),
        )
    )
    long_enough = pl.col("last_ns") - pl.col("first_ns") >= least_s * NS_PER_S
    ordered = events.filter(long_enough).sort("badness", *LOG, "first_ns", descending=[True, False, False, False])
    return ordered.drop("event", "badness")
