"""How far a batch is, on a terminal; nothing where the output is piped."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from roadperc_stream.batch.driver import BatchProgress, Failed
from roadperc_stream.core.text import shown
from roadperc_stream.output.terminal import PipeConsole
from roadperc_stream.schemas.columns.runs import RunRow

Shows = tuple[Callable[[BatchProgress], None], Failed]


@contextmanager
def batch_progress(enabled: bool) -> Iterator[Shows]:
    """A bar over the bytes of the logs, with logs and frames done, failures and the time left."""
    console = PipeConsole(stderr=True, highlight=False, markup=False, emoji=False)
    if not (enabled and console.is_terminal):
        yield (lambda _: None), (lambda _: None)
        return
    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        console.show_cursor(True)  # a program that ends at once does not give it back
        task, started_s = bar.add_task("starting", total=None), monotonic()

        def watch(now: BatchProgress) -> None:
            text = progress_text(now, monotonic() - started_s)
            completed, total = now.bytes_done + now.bytes_at_work, now.bytes_expected or None
            bar.update(task, completed=completed, total=total, description=text)

        yield watch, lambda row: console.print(shown(failure(row)), soft_wrap=True)


def progress_text(now: BatchProgress, seconds: float) -> str:
    """Logs and frames done, frames a second, and failures."""
    frames = now.frames + now.frames_at_work
    failed = f", {now.failed} failed" if now.failed else ""
    return f"{now.done}/{now.logs} logs{failed}, {frames} frames, {frames / max(seconds, 1e-9):.1f} frames/s"


def failure(row: RunRow) -> str:
    """A log that failed, in a line."""
    error = row.error or ""
    return f"{row.status:<11} {row.path}: {error.removeprefix(f'{row.path}: ')}"
