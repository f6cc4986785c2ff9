"""The page's recipe for datasets of many small files."""

import re
import subprocess
import sys
from pathlib import Path

import polars as pl

PAGE = Path(__file__).parents[2] / "docs" / "scaling.md"
DAYS = {"2026-03-01": 5, "2026-03-02": 3}


def rows(folder):
    frames = pl.scan_parquet(folder / "metrics/**/*.parquet", hive_partitioning=True)
    return frames.sort("log_id", "frame").collect()


def test_the_recipe_keeps_every_row_in_a_file_a_day(tmp_path):
    for day, logs in DAYS.items():
        folder = tmp_path / "dataset" / "metrics" / f"date={day}"
        folder.mkdir(parents=True)
        for log in range(logs):
            frames = pl.DataFrame(
                {"log_id": f"{day}{log:06d}", "frame": range(4), "lanes": [None, 0.5, 1.5, float(log)]}
            )
            frames.write_parquet(folder / f"{log}.parquet")
    runs = pl.DataFrame({"log_id": ["a"], "status": ["done"]})
    runs.write_parquet(tmp_path / "dataset" / "runs.parquet")
    (recipe,) = re.findall(
        r"^### Many small files$.*?^```python\n(.*?)^```$", PAGE.read_text(), re.DOTALL | re.MULTILINE
    )
    subprocess.run([sys.executable, "-c", recipe], cwd=tmp_path, check=True, timeout=60)
    assert rows(tmp_path / "compact").equals(rows(tmp_path / "dataset"))
    assert len(list((tmp_path / "compact" / "metrics").rglob("*.parquet"))) == len(DAYS)
    assert pl.read_parquet(tmp_path / "compact" / "runs.parquet").equals(runs)
