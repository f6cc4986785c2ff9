"""How long a report over many tables takes, and in how much memory, against polars' bare group-by over the same files.

Run it with ``make bench-report`` or ``python -m roadperc_stream.eval.bench FOLDER``.
"""

import argparse
import sys
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table

from roadperc_stream.cli.plumbing import run, whole_number
from roadperc_stream.core.cost import cost_of
from roadperc_stream.core.files import METRICS_SUFFIX
from roadperc_stream.output.tables import FACT_PREFIX, ROW_GROUP_ROWS, arrow_schema
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics

from .quantities import STORED

_FACTS: Final = {
    f"{FACT_PREFIX}{key}": value
    for key, value in {"config_digest": "0" * 64, "version": "bench", "log": "none.mcap"}.items()
}
_STATES: Final = np.array(["measured", "held", "lost"])
_REPORT: Final = "import sys; from roadperc_stream.cli.report import main; sys.exit(main(sys.argv[1:]))"
_GROUP_BY: Final = "import sys; from roadperc_stream.eval.bench import group_by; print(group_by(sys.argv[1]).shape)"


def main(argv: list[str] | None = None) -> int:
    """Write tables where there are none yet, read them both ways, print what that took."""
    parser = argparse.ArgumentParser(prog="python -m roadperc_stream.eval.bench", description=__doc__)
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="gets a folder of tables, and keeps it")
    parser.add_argument("--files", type=whole_number, default=1000, metavar="N", help="tables (1000)")
    parser.add_argument("--rows", type=whole_number, default=10_000, metavar="N", help="frames of each (10000)")
    arguments = parser.parse_args(argv)
    return run(lambda: _bench(arguments.folder / f"{arguments.files}x{arguments.rows}", arguments))


def group_by(folder: str) -> pl.DataFrame:
    """Mean and quantiles of the report's columns for each log, plainly."""
    columns = [quantity.column for quantity in STORED]
    quantiles = [
        pl.col(columns).quantile(share, "linear").name.suffix(f"_{share}") for share in (0.05, 0.5, 0.95, 0.99)
    ]
    tables = pl.scan_parquet(f"{folder}/*{METRICS_SUFFIX}")
    return tables.group_by("log_id").agg(pl.col(columns).mean(), *quantiles).collect(engine="streaming")


def write_tables(folder: Path, files: int, rows: int) -> None:
    """Tables with a replay's columns and row groups, a tenth of what may be null being so; those there are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    with frame_progress("tables", enabled=True) as progress:
        for index in range(files):
            path = folder / f"log{index:05}{METRICS_SUFFIX}"
            if not path.exists():
                _write(path, index, rows)
            progress(index + 1, files)


def _write(path: Path, index: int, rows: int) -> None:
    schema = arrow_schema(FrameMetrics, TIME_COLUMNS, _FACTS)
    rng = np.random.default_rng(index)
    columns = {field.name: _values(field, rng, rows) for field in schema}
    columns["log_id"] = pa.array([f"{index:016x}"] * rows)
    columns["frame"] = pa.array(np.arange(rows))
    columns["segment"] = pa.array([0] * rows)
    columns["stamp_ns"] = pa.array(np.arange(rows) * 50_000_000)
    partial = path.with_suffix(".partial")
    pq.write_table(pa.table(columns, schema=schema), partial, ROW_GROUP_ROWS, compression="zstd")
    partial.replace(path)


def _values(field: pa.Field, rng: np.random.Generator, rows: int) -> pa.Array:
    """Values that do not compress, as those of cameras do not."""
    null = rng.random(rows) < 0.1 if field.nullable and field.name not in TIME_COLUMNS else None
    if pa.types.is_list(field.type):
        return pa.array([("depth",) if lacks else () for lacks in rng.random(rows) < 0.02], type=field.type)
    if pa.types.is_string(field.type):
        return pa.array(_STATES[rng.choice(3, rows, p=(0.9, 0.08, 0.02))], mask=null)
    if pa.types.is_integer(field.type):
        return pa.array(rng.poisson(8, rows), mask=null)
    return pa.array(rng.gamma(2, size=rows) if field.name in TIME_COLUMNS else rng.normal(size=rows), mask=null)


def _bench(folder: Path, arguments: argparse.Namespace) -> None:
    write_tables(folder, arguments.files, arguments.rows)
    programs = {"roadperc-report": _REPORT, "bare group-by": _GROUP_BY}
    costs = {name: cost_of(name, [sys.executable, "-c", code, str(folder)]) for name, code in programs.items()}
    bare = costs["bare group-by"]
    table = Table("", "seconds", "core seconds", "peak MB", "times the bare", title=f"{folder.name} rows")
    for name, cost in costs.items():
        ratio = cost.wall_s / bare.wall_s
        table.add_row(name, f"{cost.wall_s:.1f}", f"{cost.cpu_s:.1f}", f"{cost.peak_mb:.0f}", f"{ratio:.2f}")
    Console().print(table)


if __name__ == "__main__":
    sys.exit(main())
