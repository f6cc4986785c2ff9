"""Hand-made datasets of a batch."""

import polars as pl

from roadperc_stream.output.tables import TableWriter
from roadperc_stream.schemas.columns import EXTRA_COLUMNS, FrameMetrics
from roadperc_stream.schemas.columns.runs import RUN_TIME_COLUMNS, RunRow
from roadperc_stream.tools.bench.report import run_row
from tests.eval.tables import row

A, B = "aaaa0000", "bbbb0000"
DATE = "2026-01-01"
VERSION = "1.2.3"


def log_id(number):
    return f"{number:016x}"


def frames(number, errors, **columns):
    """The rows of a log with these lane errors, metres or None."""
    return [row(k, log_id(number), lane_left_error_m=error, **columns) for k, error in enumerate(errors)]


def done(number, config=A, frames=0, **more):
    """A log's row in the list of runs."""
    path = f"/drives/drive{number}.mcap"
    known = {"log_id": log_id(number), "config": config, "status": "done", "path": path, "names": (path,)}
    return run_row(**({**known, "frames": frames, "version": VERSION, "finished_ns": number, "attempts": 1} | more))


def add_table(folder, rows, config=A, date=DATE, name=None, settings=""):
    """A table of a log as a batch writes it; 10 ms each frame."""
    path = folder / "metrics" / f"date={date}" / (name or f"{rows[0].log_id}-{config}.parquet")
    facts = {"roadperc.config_digest": config * 8, "roadperc.version": VERSION, "roadperc.config": settings}
    with TableWriter(path, FrameMetrics, facts, EXTRA_COLUMNS, {"config": config}) as table:
        for item in rows:
            table.append(item, total_ms=10.0)
    return path


def write_runs(path, rows):
    with TableWriter(path, RunRow, {}, RUN_TIME_COLUMNS) as table:
        for item in rows:
            table.append(item)


def small_dataset(folder):
    """Two logs under two configurations, the first worse under the second; a damaged log and a log with a timeout."""
    settings = {A: "", B: "[lanes]\nhold_s = 2.0\n"}
    runs = []
    for config, worse_m, finished_ns in ((A, 0.0, 0), (B, 0.5, 100)):
        for number, errors in ((1, [0.01, -0.02, 0.30, None]), (2, [0.1] * 6)):
            shift_m = worse_m if number == 1 else 0.0
            shifted = [None if error is None else abs(error) + shift_m for error in errors]
            status = ["measured", "held"][number - 1]
            rows = frames(
                number, shifted, lane_left_status=status, surface_source="depth", missing=("depth",) * (number - 1)
            )
            add_table(folder, rows, config, f"2026-01-0{number}")
            more = {"settings": settings[config], "config_digest": config * 8, "date": f"2026-01-0{number}"}
            runs.append(done(number, config, len(rows), **more | {"finished_ns": finished_ns + number}))
    bad = {"log_id": None, "path": "/drives/bad.mcap", "names": ("/drives/bad.mcap",), "status": "damaged"}
    runs += [done(3, config, error="/drives/bad.mcap: cut off at byte 7", **bad) for config in (A, B)]
    runs.append(done(4, A, status="timeout", error="took more than 60 s"))
    write_runs(folder / "runs.parquet", runs)
    return folder


def compact(folder, date=DATE, name="part-0.parquet"):
    """Merge the tables of a day into one, in reverse order of their names."""
    day = folder / "metrics" / f"date={date}"
    parts = sorted(day.iterdir(), reverse=True)
    pl.concat([pl.read_parquet(path, hive_partitioning=False) for path in parts]).write_parquet(
        day / name, row_group_size=5
    )
    for path in parts:
        path.unlink()
