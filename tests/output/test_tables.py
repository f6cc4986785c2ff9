"""Tables are read from bytes in memory."""

import subprocess
import sys

import pyarrow as pa
import pyarrow.parquet as pq

CODE = """
import sys
from pathlib import Path

import psutil

from roadperc_stream.output.tables import rows_in

data, process = Path(sys.argv[1]).read_bytes(), psutil.Process()
before = process.num_threads()
rows = rows_in(data, "address")
print(rows[1]["c7"], process.num_threads() - before)
"""


def test_arrow_threads_do_not_hold_python_bytes(tmp_path):
    """A thread that releases them while the interpreter ends aborts the process, up to Python 3.13."""
    pq.write_table(pa.table({f"c{k}": ["a", "b"] for k in range(45)}), tmp_path / "table.parquet")
    command = [sys.executable, "-c", CODE, str(tmp_path / "table.parquet")]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout == "b 0\n"
