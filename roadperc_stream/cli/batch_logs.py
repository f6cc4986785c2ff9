"""What ``roadperc-batch`` does with its arguments, and what it says of the logs."""

import argparse
from contextlib import AbstractContextManager
from time import perf_counter

from roadperc_stream.batch.backend import Backend
from roadperc_stream.batch.configuration import BatchConfiguration
from roadperc_stream.batch.display import Shows, batch_progress, failure
from roadperc_stream.batch.job import BatchJob
from roadperc_stream.batch.local import LocalBackend
from roadperc_stream.batch.plan import Again, counted
from roadperc_stream.batch.running import BatchRun, BatchSummary
from roadperc_stream.batch.splitting import overlap_s_of, require_split
from roadperc_stream.batch.task import KeepLogs, TaskLimits
from roadperc_stream.cli.arguments import config_of, time_range_of
from roadperc_stream.core.files import target_errors
from roadperc_stream.core.process import optional_output
from roadperc_stream.core.text import number, print_line
from roadperc_stream.core.threads import usable_cores
from roadperc_stream.errors import RoadpercError
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.storage.folder import Folder


def batch_logs(arguments: argparse.Namespace) -> None:
    """Replay many logs into one dataset as the arguments say.

    Raises:
        RoadpercError: a log failed, or nothing could be done at all.
    """
    started = perf_counter()
    job = _job(arguments)
    again = Again(arguments.verify, arguments.retry_failed, arguments.recover, job.keep_logs)
    batch = BatchRun(job, arguments.logs, arguments.join, again)
    if arguments.dry_run:
        _print_plan(batch)
        return
    try:
        summary = batch.run(lambda: _backend(arguments), lambda: _display(arguments))
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; the same command goes on with what is not done") from None
    with optional_output():
        if not arguments.quiet:
            _print_summary(job, summary, perf_counter() - started)
        for row in summary.failed:
            print_line(failure(row))
    if summary.failed:
        failed = f"{len(summary.failed)} of {number(len(batch.steps), 'log')}"
        raise RoadpercError(f"{job.out.address}: {failed} failed; runs.parquet there says how")


def _job(arguments: argparse.Namespace) -> BatchJob:
    topics = tuple(sorted(parse_topic_options(arguments.topic).items()))
    how = BatchConfiguration(
        config_of(arguments), topics, time_range_of(arguments), arguments.split, arguments.warm_up or 0.0
    )
    if how.split_s is not None:
        require_split(how.split_s, overlap_s_of(how.cfg))
    keep_logs: KeepLogs = "no"
    if arguments.keep_logs:
        keep_logs = "results" if arguments.results_only else "whole"
    return BatchJob(
        how,
        Folder(arguments.out),
        keep_logs,
        arguments.recover,
        TaskLimits(arguments.timeout, arguments.memory),
        arguments.retries,
        arguments.fail_fast,
        arguments.scratch,
    )


def _backend(arguments: argparse.Namespace) -> Backend:
    jobs = arguments.jobs or usable_cores()
    if arguments.ray is None:
        if arguments.scratch is not None:
            with target_errors(arguments.scratch):
                arguments.scratch.mkdir(parents=True, exist_ok=True)
        return LocalBackend(jobs)
    from roadperc_stream.batch.cluster import RayBackend

    return RayBackend(arguments.ray, jobs, arguments.memory)


def _display(arguments: argparse.Namespace) -> AbstractContextManager[Shows]:
    return batch_progress(not arguments.quiet)


def _print_plan(batch: BatchRun) -> None:
    for step in batch.steps:
        if step.action != "leave":
            parts = f" ({len(step.drive.files)} parts)" if len(step.drive.files) > 1 else ""
            print_line(f"{step.action}  {step.drive.name}{parts}: {step.why}")
    for text, logs in sorted(counted(batch.steps).items()):
        print_line(f"{number(logs, 'log')}  {text}")


def _print_summary(job: BatchJob, summary: BatchSummary, seconds: float) -> None:
    left = f", {summary.left} left as they are" if summary.left else ""
    failed = f", {len(summary.failed)} failed" if summary.failed else ""
    rate = f" ({summary.frames / seconds:.1f} frames/s)" if summary.frames else ""
    undone = f", {summary.undone} not begun" if summary.undone else ""
    print_line(
        f"{number(summary.done, 'log')} done{left}{failed}{undone}: {summary.frames} frames in {seconds:.1f} s{rate}"
    )
    print_line(f"dataset {job.out.address}, configuration {job.how.name}")
