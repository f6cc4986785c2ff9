"""Runs ``roadperc-batch``: makes the job, shows progress on a terminal, and prints the results."""

import argparse
import os
import secrets
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic, perf_counter

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from roadperc_stream.batch.backend import Backend, LocalBackend
from roadperc_stream.batch.driver import BatchProgress, BatchRun, BatchSummary, OnProgress
from roadperc_stream.batch.location import Location
from roadperc_stream.batch.task import BatchConfiguration, BatchJob, KeepLogs
from roadperc_stream.batch.worker import scratch_root
from roadperc_stream.chain.own_stage import own_stages
from roadperc_stream.cli.arguments import config_of, time_range_of
from roadperc_stream.errors import ClusterError, RoadpercError
from roadperc_stream.info.contract import read_contract
from roadperc_stream.output.tables import config_digest
from roadperc_stream.output.terminal import PipeConsole
from roadperc_stream.schemas.columns.runs import RunRow
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import listed, number, print_line, shown
from roadperc_stream.system.threads import usable_cores

_SAME_NAMES = ("recover", "retries", "fail_fast", "verify", "retry_failed", "scratch")
"""Arguments that a ``BatchJob`` has under the same name."""
_RAY = {
    # Otherwise Ray sends the working folder, logs included, to the machines and runs uv there.
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",
    "RAY_gcs_server_request_timeout_seconds": "20",
    "RAY_CLIENT_INITIAL_CONNECTION_TIMEOUT_S": "30",  # the default of 5 s is too short for a busy head
    "RAY_USAGE_STATS_ENABLED": "0",
}
"""Environment variables for Ray, unless the user sets them; Ray reads them when it is imported."""


def batch_logs(arguments: argparse.Namespace) -> None:
    """Replay many logs into one dataset as the arguments say.

    Raises:
        RoadpercError: a log failed, or the batch cannot run.
    """
    started = perf_counter()
    job = _job(arguments)
    batch = BatchRun(job, arguments.logs, arguments.join)
    if arguments.dry_run:
        _print_plan(batch)
        return
    try:
        summary = batch.run(lambda: _backend(arguments, job), lambda: _progress_shown(not arguments.quiet))
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; run the same command again to continue") from None
    with optional_output():
        if not arguments.quiet:
            _print_summary(job, summary, perf_counter() - started)
        for row in summary.failed:
            print_line(_failure(row))
        for row in summary.broken:
            print_line(f"{'broken':<11} {row.path}: {listed(row.broken, 1)}")
    if summary.failed:
        failed = f"{len(summary.failed)} of {number(len(batch.logs), 'log')}"
        raise RoadpercError(f"{job.out.address}: {failed} failed; see status and error in runs.parquet")


def _job(arguments: argparse.Namespace) -> BatchJob:
    topics = tuple(sorted(parse_topic_options(arguments.topic).items()))
    configuration = BatchConfiguration(own_stages(config_of(arguments))[0], topics, time_range_of(arguments))
    kept: KeepLogs = "results" if arguments.results_only else "whole"
    return BatchJob(
        configuration,
        Location(arguments.out),
        kept if arguments.keep_logs else "no",
        timeout_s=arguments.timeout,
        memory_bytes=arguments.memory,
        contract=None if arguments.contract is None else read_contract(arguments.contract),
        **{name: getattr(arguments, name) for name in _SAME_NAMES},
    )


def _backend(arguments: argparse.Namespace, job: BatchJob) -> Backend:
    jobs = arguments.jobs or usable_cores()
    if arguments.ray is None:
        scratch_root(job)
        return LocalBackend(jobs)
    token = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)} if arguments.ray == "local" else {}
    os.environ |= _RAY | token | os.environ
    try:
        from roadperc_stream.batch.cluster import RayBackend
    except ImportError:
        error = "--ray: Ray is not installed; pip install '.[cluster]' in the project's folder"
        raise ClusterError(error) from None
    return RayBackend(arguments.ray, jobs, arguments.memory)


def _print_plan(batch: BatchRun) -> None:
    steps = batch.plan()
    for step in steps:
        if step.action != "skip":
            files = f" ({len(step.log.files)} files)" if len(step.log.files) > 1 else ""
            print_line(f"{step.action}  {step.log.name}{files}: {step.why}")
    for text, logs in sorted(Counter(f"{step.action}: {step.why}" for step in steps).items()):
        print_line(f"{number(logs, 'log')}  {text}")


def _print_summary(job: BatchJob, summary: BatchSummary, seconds: float) -> None:
    skipped = f", {summary.skipped} skipped" if summary.skipped else ""
    failed = f", {len(summary.failed)} failed" if summary.failed else ""
    rate = f" ({summary.frames / seconds:.1f} frames/s)" if summary.frames else ""
    not_started = f", {summary.not_started} not started" if summary.not_started else ""
    logs = f"{number(summary.done, 'log')} done{skipped}{failed}{not_started}"
    print_line(f"{logs}: {summary.frames} frames in {seconds:.1f} s{rate}")
    digest = config_digest(job.configuration.cfg)[:8]
    print_line(f"dataset {job.out.address}, config {job.configuration.name}, settings {digest}")


@contextmanager
def _progress_shown(enabled: bool) -> Iterator[OnProgress]:
    """Show a bar over the bytes of the logs, with logs and frames done, failures and the remaining time."""
    console = PipeConsole(stderr=True, highlight=False, markup=False, emoji=False)
    if not (enabled and console.is_terminal):
        yield lambda _: None
        return
    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        console.show_cursor(True)  # a killed program does not restore it
        task, started_s, shown_rows = bar.add_task("starting", total=None), monotonic(), 0

        def show(now: BatchProgress) -> None:
            nonlocal shown_rows
            for row in now.failed[shown_rows:]:
                console.print(shown(_failure(row)), soft_wrap=True)
            shown_rows = len(now.failed)
            text = _progress_text(now, monotonic() - started_s)
            completed, total = now.bytes_done + now.bytes_running, now.bytes_expected or None
            bar.update(task, completed=completed, total=total, description=text)

        yield show


def _progress_text(now: BatchProgress, seconds: float) -> str:
    """Logs and frames done, frames per second, and failures."""
    frames = now.frames + now.frames_running
    failed = f", {len(now.failed)} failed" if now.failed else ""
    return f"{now.done}/{now.logs} logs{failed}, {frames} frames, {frames / max(seconds, 1e-9):.1f} frames/s"


def _failure(row: RunRow) -> str:
    """One line for a failed log."""
    error = row.error or ""
    return f"{row.status:<11} {row.path}: {error.removeprefix(f'{row.path}: ')}"
