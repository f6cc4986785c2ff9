"""What a replay wrote, put into the dataset under the names that log and configuration give."""

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


def publish(task: Task, target: ReplayTarget, summary: ReplaySummary) -> Outcome:
    """Put tables and, with ``--logs``, the log into the dataset; the table of frames comes last.

    Args:
        task: of the log.
        target: what was written.
        summary: of the replay.

    Raises:
        StorageError: the dataset cannot be written.
        TargetError: there is no space for what is copied.
    """
    job, log_id = task.job, summary.log_id
    date = datetime.fromtimestamp(summary.first_ns // NS_PER_S, UTC).date().isoformat()
    names = {folder: name_in(folder, date, log_id, job.how.name) for folder in (METRICS, OBJECTS, LOGS)}
    keeps_log = job.keep_logs != "no"
    facts = {"source": task.drive.name, "log": job.out.at(names[LOGS]).address if keeps_log else ""}
    facts["options"] = job.how.options
    measured = totals(target.metrics, TIME_COLUMNS)
    if keeps_log:
        job.out.at(names[LOGS]).put(target.path)
    else:
        job.out.at(names[LOGS]).remove()  # of an earlier run: it would stand beside tables of this one
    for folder, table in ((OBJECTS, target.objects), (METRICS, target.metrics)):
        copy = table.with_suffix(".copy")
        copy_table(table, copy, facts, {"config": job.how.name})
        job.out.at(names[folder]).put(copy)
    return Outcome(
        "done",
        log_id=log_id,
        date=date,
        duration_s=measured.span_ns / NS_PER_S,
        frames=measured.rows,
        frames_before=summary.frames_before,
        dropped=sum(summary.dropped.values()),
        unreadable=sum(summary.problems.values()),
        warnings=tuple(map(as_text, summary.warnings)),
        stages_s={stage_column(name): value / 1000 for name, value in measured.sums.items()},
    )
