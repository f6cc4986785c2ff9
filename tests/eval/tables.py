"""Hand-made metrics tables."""

from collections.abc import Callable, Sequence
from pathlib import Path

import polars as pl
import pytest

from roadperc_stream.eval.report.sources import load, source_of_runs
from roadperc_stream.eval.report.summaries import Summary, groups_of_runs, summarise
from roadperc_stream.eval.runs import Run, find_runs
from roadperc_stream.output.tables import TableWriter, arrow_schema
from roadperc_stream.schemas.columns import EXTRA_COLUMNS, FrameMetrics, ObjectMetrics
from roadperc_stream.schemas.columns.hindsight import TRACK_HINDSIGHT

STEP_NS = 50_000_000
START_NS = 1_577_836_800_000_000_000


def row(frame: int, log_id: str = "a" * 16, **columns) -> FrameMetrics:
    """A frame at 20 Hz with nothing but what is asked for."""
    return FrameMetrics(log_id, frame, START_NS + frame * STEP_NS, **columns)


def write(
    path: Path,
    rows: Sequence[FrameMetrics],
    times: Sequence[dict[str, float]] = (),
    config: str = "c" * 64,
    **more: str,
) -> Path:
    """A metrics table as a replay writes it; ``times`` are the time columns of each row, 10 ms in all by default.

    ``more`` are facts of its footer, such as ``continues``.
    """
    facts = {"config_digest": config, "version": "1.2.3", "log": "out.mcap", **more}
    facts = {f"roadperc.{key}": value for key, value in facts.items()}
    with TableWriter(path, FrameMetrics, facts, EXTRA_COLUMNS) as table:
        for index, item in enumerate(rows):
            table.append(item, **(times[index] if times else {"total_ms": 10.0}))
    return path


def run_of(path: Path) -> Run:
    """The run of one table."""
    (run,) = find_runs([str(path)])
    return run


def usage_error(main: Callable[[list[str]], int], capsys, *arguments) -> str:
    """The stderr of a command that ends with exit code 2."""
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    assert end.value.code == 2
    return capsys.readouterr().err


def outcome(main: Callable[[list[str]], int], capsys, *arguments) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command."""
    code = main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def object_rows(columns):
    """A table of objects with some columns; the others are null."""
    known = pl.DataFrame(arrow_schema(ObjectMetrics, TRACK_HINDSIGHT).empty_table()).schema
    others = [pl.lit(None, kind).alias(name) for name, kind in known.items() if name not in columns]
    return pl.DataFrame(columns).with_columns(others)


def summary_of(*runs: Run, worst: int = 3) -> Summary:
    """The figures over all frames of some runs."""
    frames = load(source_of_runs(runs))
    name = runs[0].name if len(runs) == 1 else "all"
    ((summary,),) = summarise(frames, [groups_of_runs(frames, [name] * len(runs))], worst=worst)
    return summary
