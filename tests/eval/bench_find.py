"""Measure ``roadperc-find`` on the dataset of many logs, of which every hundredth has one event.

Run ``make bench-find`` or ``python -m tests.eval.bench_find FOLDER``.
"""

import argparse
import sys
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from roadperc_stream.cli.launch import run
from roadperc_stream.cli.values import whole_number
from roadperc_stream.output.tables import ROW_GROUP_ROWS, TableWriter, arrow_schema
from roadperc_stream.output.terminal import console_for, frame_progress, print_table
from roadperc_stream.output.text_table import Table
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics, ObjectMetrics
from roadperc_stream.schemas.columns.runs import RUN_TIME_COLUMNS, RunRow
from roadperc_stream.tools.bench.replays import cost_of
from roadperc_stream.tools.bench.report import run_row

EVERY: Final = 100
"""One log of so many has an event."""
IMPACT: Final = "time_to_impact_s < 2 and lane_change <> 'none'"
NEAR: Final = "objects.distance_m < 2 and lane_change <> 'none'"
_CONFIG: Final = "00000000"
_ID: Final = b"id of the log..."
"""Stands for the 16 digits of a log, which are not compressed, so that a table can be copied for other logs."""
_TEMPLATES: Final = 16
"""Different random tables."""
_ROWS: Final = {"metrics": (FrameMetrics, TIME_COLUMNS, 1), "objects": (ObjectMetrics, (), 2)}
"""The tables of a log: rows, further columns, and rows of each frame."""
_FIND: Final = "import sys; from roadperc_stream.cli.find import main; sys.exit(main(sys.argv[1:]))"


def main(argv: list[str] | None = None) -> int:
    """Write missing tables, find the events twice by columns of frames and of objects, and print the second times."""
    parser = argparse.ArgumentParser(prog="python -m tests.eval.bench_find", description=__doc__)
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="folder that keeps the dataset")
    parser.add_argument("--logs", type=whole_number, default=10_000, metavar="N", help="logs (10000)")
    parser.add_argument("--frames", type=whole_number, default=600, metavar="N", help="frames of each log (600)")
    arguments = parser.parse_args(argv)
    return run(lambda: _bench(arguments))


def write_dataset(folder: Path, logs: int, frames: int) -> None:
    """Write the dataset of a batch with tables of frames and of objects; existing tables stay."""
    folder.mkdir(parents=True, exist_ok=True)
    with (
        frame_progress("tables", enabled=True) as progress,
        TableWriter(folder / "runs.parquet", RunRow, {}, RUN_TIME_COLUMNS) as runs,
    ):
        for index in range(logs):
            log_id, path, date = f"{index:016x}", f"/logs/log{index:05}.mcap", f"2026-01-{index % 30 + 1:02}"
            for kind in _ROWS:
                table = folder / kind / f"date={date}" / f"{log_id}-{_CONFIG}.parquet"
                if not table.exists():
                    table.parent.mkdir(parents=True, exist_ok=True)
                    event = index % EVERY == 0
                    table.write_bytes(_template(kind, index % _TEMPLATES, frames, event).replace(_ID, log_id.encode()))
            more: dict[str, Any] = {"date": date, "frames": frames, "version": "bench", "status": "done"}
            runs.append(run_row(log_id=log_id, path=path, names=(path,), config=_CONFIG, **more))
            progress(index + 1, logs)


@cache
def _template(kind: str, seed: int, frames: int, event: bool) -> bytes:
    """The table of a log, with ``_ID`` as its ``log_id``.

    In an event the time to impact and the distance of the objects fall from 1.2 to 1 in the middle third.
    """
    row_type, times, copies = _ROWS[kind]
    frame, middle, rows = np.arange(frames), frames // 2, frames * copies
    inside, changes = event & (np.abs(frame - middle) < frames / 6), frame % 100 == 0  # a change without an event
    values = np.where(changes, 5.0, np.random.default_rng(seed).uniform(0, 10, frames))
    values = np.where(inside, 1 + np.abs(frame - middle) / frames, values)
    of_frames = {
        "frame": frame,
        "segment": 0 * frame,
        "stamp_ns": frame * 50_000_000,
        "lane_change": np.where(inside | changes, "left", "none"),
        "time_to_impact_s": values,
        "distance_m": values,
    }
    named = {name: np.repeat(column, copies) for name, column in of_frames.items()}
    named |= {"log_id": np.repeat(_ID.decode(), rows), "config": np.repeat(_CONFIG, rows)}
    schema = arrow_schema(row_type, times, {}, {"config": _CONFIG})
    rng = np.random.default_rng(seed)
    columns = {field.name: pa.array(named.get(field.name, _random(field.type, rng, rows))) for field in schema}
    table = pa.table({name: columns[name].cast(schema.field(name).type) for name in columns}, schema=schema)
    compression = dict.fromkeys(schema.names, "zstd") | {"log_id": "none"}
    pq.write_table(table, buffer := BytesIO(), ROW_GROUP_ROWS, compression=compression)
    return buffer.getvalue()


def _random(kind: pa.DataType, rng: np.random.Generator, rows: int) -> Any:
    """Random values of a type; random floats do not compress, like real ones."""
    if pa.types.is_list(kind):
        return [[] for _ in range(rows)]
    if pa.types.is_string(kind):
        return rng.choice(["measured", "held", "lost"], rows, p=(0.9, 0.08, 0.02))
    return rng.normal(size=rows) if pa.types.is_floating(kind) else rng.integers(0, 2, rows)


def _bench(arguments: argparse.Namespace) -> None:
    folder = arguments.folder / f"{arguments.logs}x{arguments.frames}"
    write_dataset(folder, arguments.logs, arguments.frames)
    rows = []
    for condition in (IMPACT, NEAR):
        command = [sys.executable, "-c", _FIND, str(folder), condition]
        cost_of(condition, command)  # reads the tables into the disk cache
        cost = cost_of(condition, command)
        rows.append((condition, f"{cost.wall_s:.1f}", f"{cost.cpu_s:.1f}", f"{cost.peak_mb:.0f}"))
    headers = ("seconds", "core seconds", "peak MB")
    print_table(console_for(sys.stdout), Table(f"{folder.name} frames", headers, tuple(rows)))


if __name__ == "__main__":
    sys.exit(main())
