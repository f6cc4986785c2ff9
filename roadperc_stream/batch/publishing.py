"""What a replay wrote, put into the dataset under the names that log and configuration give."""

from dataclasses import replace
from datetime import UTC, datetime

from roadperc_stream.batch.task import Outcome, Task, as_text
from roadperc_stream.output.tables import copy_table, totals
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import ReplaySummary
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.columns.runs import stage_column
from roadperc_stream.system.files import TABLE_SUFFIX
from roadperc_stream.system.time import NS_PER_S

METRICS, OBJECTS, LOGS = "metrics", "objects", "logs"
"""The folders of a dataset."""


def name_in(folder: str, date: str, log_id: str, config: str) -> str:
    """Where a file of a log under a configuration lies in the dataset."""
    suffix = ".mcap" if folder == LOGS else TABLE_SUFFIX
    return f"{folder}/date={date}/{log_id}-{config}{suffix}"


def of_summary(summary: ReplaySummary) -> Outcome:
    """What a replay says of itself."""
    dropped, unreadable = sum(summary.dropped.values()), sum(summary.problems.values())
    return Outcome(
        "done",
        dropped=dropped,
        unreadable=unreadable,
        warnings=tuple(map(as_text, summary.warnings)),
        frames=summary.frames,
        frames_before=summary.frames_before,
    )


def publish(task: Task, target: ReplayTarget, log_id: str, first_ns: int, replayed: Outcome) -> Outcome:
    """Put tables and, where it is asked for, the log into the dataset; the table of frames comes last.

    Args:
        task: of the log.
        target: what was written.
        log_id: of the log.
        first_ns: log time of its first message.
        replayed: what is known of the replay.

    Returns:
        The same, with what the tables say.

    Raises:
        StorageError: the dataset cannot be written.
        TargetError: there is no space for what is copied.
    """
    date = date_of(first_ns)
    names = {folder: name_in(folder, date, log_id, task.how.name) for folder in (METRICS, OBJECTS, LOGS)}
    keeps_log = task.keep_logs != "no"
    facts = {"source": task.drive.name, "log": task.out.at(names[LOGS]).address if keeps_log else ""}
    facts["options"] = task.how.options
    measured = totals(target.metrics, TIME_COLUMNS)
    if keeps_log:
        task.out.at(names[LOGS]).put(target.path)
    else:
        task.out.at(names[LOGS]).remove()  # of an earlier run: it would stand beside tables of this one
    for folder, table in ((OBJECTS, target.objects), (METRICS, target.metrics)):
        copy = table.with_suffix(".copy")
        copy_table(table, copy, facts, {"config": task.how.name})
        task.out.at(names[folder]).put(copy)
    return replace(
        replayed,
        log_id=log_id,
        date=date,
        duration_s=measured.span_ns / NS_PER_S,
        frames=measured.rows,
        stages_s={stage_column(name): value / 1000 for name, value in measured.sums.items()},
    )


def date_of(time_ns: int) -> str:
    """The UTC date of a time since 1970; a log without a clock's time counts from there."""
    return datetime.fromtimestamp(time_ns // NS_PER_S, UTC).date().isoformat()
