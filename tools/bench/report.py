"""Compare time and memory of a report over many tables with a plain group-by of polars.

The tables are those of a batch's dataset. Run ``make bench-report`` or
``python -m roadperc_stream.tools.bench.report FOLDER``.
"""

import argparse
import sys
from pathlib import Path
from typing import Any, Final, get_type_hints

import numpy as np
import polars as pl
import pyarrow as pa

from roadperc_stream.cli.launch import run
from roadperc_stream.cli.values import whole_number
from roadperc_stream.model import Reason
from roadperc_stream.output.tables import FACT_PREFIX, ROW_GROUP_ROWS, TableWriter, arrow_schema, parquet_writer
from roadperc_stream.output.terminal import console_for, frame_progress, print_table
from roadperc_stream.output.text_table import Table
from roadperc_stream.schemas.columns import EXTRA_COLUMNS, TIME_COLUMNS, FrameMetrics, columns_of
from roadperc_stream.schemas.columns.hindsight import FrameHindsight
from roadperc_stream.schemas.columns.runs import RUN_TIME_COLUMNS, RunRow

from .replays import cost_of

_COLUMNS: Final = (
    *(name for row in (FrameMetrics, FrameHindsight) for name, column in columns_of(row).items() if column.label),
    *TIME_COLUMNS,
)
"""The columns in a report."""
_FACTS: Final = {f"{FACT_PREFIX}{key}": "bench" for key in ("config_digest", "version", "log")}
_CONFIGS: Final = ("00000000", "11111111")
_NO_DEPTH: Final = Reason("surface", "no_depth")
_STATES: Final = np.array(["measured", "held", "lost"])
_REPORT: Final = "import sys; from roadperc_stream.cli.report import main; sys.exit(main(sys.argv[1:]))"
_GROUP_BY: Final = "import sys; from roadperc_stream.tools.bench.report import group_by; group_by(sys.argv[1])"


def main(argv: list[str] | None = None) -> int:
    """Write missing tables, read all tables both ways, and print time and memory."""
    parser = argparse.ArgumentParser(prog="python -m roadperc_stream.tools.bench.report", description=__doc__)
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="folder that keeps the dataset")
    parser.add_argument("--files", type=whole_number, default=5000, metavar="N", help="tables (5000)")
    parser.add_argument("--rows", type=whole_number, default=2000, metavar="N", help="frames of each table (2000)")
    arguments = parser.parse_args(argv)
    return run(lambda: _bench(arguments))


def group_by(folder: str) -> pl.DataFrame:
    """Return mean and quantiles of the report's columns for each configuration of a dataset."""
    shares = (0.05, 0.5, 0.95, 0.99)
    quantiles = [pl.col(_COLUMNS).quantile(share, "linear").name.suffix(f"_{share}") for share in shares]
    tables = pl.scan_parquet(f"{folder}/metrics/*/*.parquet")
    return tables.group_by("config").agg(pl.col(_COLUMNS).mean(), *quantiles).collect(engine="streaming")


def write_dataset(folder: Path, files: int, rows: int) -> None:
    """Write the dataset of a batch: logs of thirty days with two configurations each; existing tables stay."""
    folder.mkdir(parents=True, exist_ok=True)
    runs = [
        run_row(
            log_id=f"{index // 2:016x}",
            config=_CONFIGS[index % 2],
            status="done",
            path=f"/logs/log{index // 2:05}.mcap",
            names=(f"/logs/log{index // 2:05}.mcap",),
            date=f"2026-01-{index // 2 % 30 + 1:02}",
            duration_s=rows / 20,
            frames=rows,
            version="bench",
            settings=f"seed = {index % 2}\n",
            attempts=1,
        )
        for index in range(files)
    ]
    with frame_progress("tables", enabled=True) as progress:
        for index, item in enumerate(runs):
            path = folder / "metrics" / f"date={item.date}" / f"{item.log_id}-{item.config}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                _write(path, index // 2, rows, item.config)
            progress(index + 1, files)
    with TableWriter(folder / "runs.parquet", RunRow, {}, RUN_TIME_COLUMNS) as table:
        for item in runs:
            table.append(item)


def run_row(**known: object) -> RunRow:
    """Return a row of ``runs.parquet`` with some known values; the others are empty, 0, false or null."""
    empty = {str: "", int: 0, float: 0.0, bool: False, tuple[str, ...]: ()}
    hints = get_type_hints(RunRow)
    values: dict[str, Any] = {name: known.get(name, empty.get(hint)) for name, hint in hints.items()}
    return RunRow(**values)


def _write(path: Path, index: int, rows: int, config: str) -> None:
    schema = arrow_schema(FrameMetrics, EXTRA_COLUMNS, _FACTS, {"config": config})
    rng = np.random.default_rng(index)
    columns = {field.name: _values(field, rng, rows) for field in schema}
    columns["log_id"] = pa.array([f"{index:016x}"] * rows)
    columns["frame"] = pa.array(np.arange(rows))
    columns["segment"] = pa.array([0] * rows)
    columns["stamp_ns"] = pa.array(np.arange(rows) * 50_000_000)
    columns["config"] = pa.array([config] * rows)
    partial = path.with_suffix(".partial")
    with parquet_writer(partial, schema) as table:
        table.write_table(pa.table(columns, schema=schema), ROW_GROUP_ROWS)
    partial.replace(path)


def _values(field: pa.Field, rng: np.random.Generator, rows: int) -> pa.Array:
    """Return random values, which do not compress, like real ones."""
    null = rng.random(rows) < 0.1 if field.nullable and field.name not in TIME_COLUMNS else None
    if pa.types.is_list(field.type):
        kind = field.type.value_type
        value = _NO_DEPTH.stored if pa.types.is_struct(kind) else "depth" if pa.types.is_string(kind) else 9.0
        return pa.array([(value,) if lacks else () for lacks in rng.random(rows) < 0.02], type=field.type)
    if pa.types.is_string(field.type):
        return pa.array(_STATES[rng.choice(3, rows, p=(0.9, 0.08, 0.02))], mask=null)
    if pa.types.is_integer(field.type):
        return pa.array(rng.poisson(8, rows), mask=null)
    return pa.array(rng.gamma(2, size=rows) if field.name in TIME_COLUMNS else rng.normal(size=rows), mask=null)


def _bench(arguments: argparse.Namespace) -> None:
    folder = arguments.folder / f"{arguments.files}x{arguments.rows}"
    write_dataset(folder, arguments.files, arguments.rows)
    programs = {"roadperc-report": _REPORT, "plain group-by": _GROUP_BY}
    costs = {name: cost_of(name, [sys.executable, "-c", code, str(folder)]) for name, code in programs.items()}
    plain = costs["plain group-by"]
    rows = [
        (name, f"{c.wall_s:.1f}", f"{c.cpu_s:.1f}", f"{c.peak_mb:.0f}", f"{c.wall_s / plain.wall_s:.2f}")
        for name, c in costs.items()
    ]
    headers = ("seconds", "core seconds", "peak MB", "ratio")
    print_table(console_for(sys.stdout), Table(f"{folder.name} rows", headers, tuple(rows)))


if __name__ == "__main__":
    sys.exit(main())
