"""The row of a log under one configuration, in the list of a batch."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal, get_args

from roadperc_stream.schemas.columns.column import COUNT, Column
from roadperc_stream.schemas.columns.frame import TIME_COLUMNS

RunStatus = Literal["done", "empty", "damaged", "unfit", "timeout", "memory", "killed", "unreachable"]
"""Outcome of a log: ``empty`` has no frame, ``damaged`` cannot be read, ``unfit`` has channels or times that the chain
cannot use. The last four depend on the machine, not on the log."""
STATUSES: Final[tuple[RunStatus, ...]] = get_args(RunStatus)


def stage_column(name: str) -> str:
    """Return the column of a stage's seconds in all frames, for its column of milliseconds in one frame."""
    return f"{name.removesuffix('_ms')}_s"


OF_THE_MACHINE: Final = frozenset({"timeout", "memory", "killed", "unreachable"})
"""Outcomes that a new attempt may change."""
RUN_TIME_COLUMNS: Final = tuple(map(stage_column, TIME_COLUMNS))
"""A column for each time in the table of frames."""

_UNKNOWN = "the log could not be read"


@dataclass(frozen=True)
class RunRow:
    """A log under one configuration: its outcome, duration, code and settings."""

    log_id: Annotated[str | None, Column("digest of the log's messages, 16 digits", null=_UNKNOWN)]
    config: Annotated[str, Column("digest of settings and options, 8 digits")]
    status: Annotated[
        str, Column("`done`, `empty`, `damaged`, `unfit`, `timeout`, `memory`, `killed` or `unreachable`")
    ]
    error: Annotated[str | None, Column("what went wrong, in a line", null="nothing")]
    path: Annotated[str, Column("path or address of the log, or of its first file")]
    names: Annotated[tuple[str, ...], Column("all known paths and addresses of the log")]
    fingerprints: Annotated[tuple[str, ...], Column("size and modification time of the log under each name")]
    date: Annotated[str | None, Column("UTC date of the log's first message, YYYY-MM-DD", null=_UNKNOWN)]
    duration_s: Annotated[float | None, Column("first to last frame, summed over segments", "s", "no frame")]
    size_bytes: Annotated[int, Column("of the log's files")]
    frames: Annotated[int, Column("frames replayed", COUNT)]
    dropped: Annotated[int, Column("messages that belong to no frame", COUNT)]
    unreadable: Annotated[int, Column("messages that could not be decoded", COUNT)]
    warnings: Annotated[tuple[str, ...], Column("messages saved and lost with `--recover`, and other warnings")]
    findings: Annotated[tuple[str, ...], Column("the [findings](findings.md), as `code: text`")]
    contract: Annotated[
        str | None,
        Column("digest of the contract that judged the log, 8 digits", null="no `--contract`, or unreadable"),
    ]
    broken: Annotated[tuple[str, ...], Column("limits of the [contract](recordings.md#contracts) that the log breaks")]
    seconds: Annotated[float, Column("the last attempt, from start to end", "s")]
    peak_memory_mb: Annotated[float | None, Column("peak memory of its process", "MB", "the process was killed")]
    version: Annotated[str, Column("version of the program")]
    code: Annotated[str, Column("version of the results, raised when values change")]
    libraries: Annotated[str, Column("versions of the libraries that compute")]
    config_digest: Annotated[str, Column("digest of the settings, as in the tables' footers")]
    settings: Annotated[str, Column("the settings that are not the default, as TOML")]
    options: Annotated[str, Column("other options that results depend on")]
    recover: Annotated[bool, Column("whether `--recover` was given")]
    logs: Annotated[str, Column("the result log in the dataset: `no`, `whole`, or `results` without the input")]
    digest_algorithm: Annotated[str, Column("algorithm of `log_id`")]
    worker: Annotated[str, Column("host and process of the last attempt")]
    attempts: Annotated[int, Column("number of attempts in the batch that wrote this row", COUNT)]
    finished_ns: Annotated[int, Column("time at which this row was written, since 1970", "ns")]
