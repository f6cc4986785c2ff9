"""A batch whose logs and dataset are in an object store: a real server."""

import os

import polars as pl

from roadperc_stream.batch.location import Location
from roadperc_stream.schemas.columns import TIME_COLUMNS
from tests.batch.dataset import METRICS, OBJECTS, batch, single, write_log


def table(bucket, kind, log_id, tmp_path):
    """The rows of a log in the store."""
    (file,) = (file for file in Location(f"{bucket}/out/{kind}").files(".parquet").values() if log_id in file.address)
    copy = tmp_path / "table.parquet"
    Location(file.address).fetch(copy)
    return pl.read_parquet(copy).drop("config", *TIME_COLUMNS, strict=False)


def test_logs_and_dataset_in_a_store(tmp_path, bucket, monkeypatch):
    sources = [write_log(tmp_path / "in" / f"{number}.mcap", lane_m=0.05 * number) for number in range(2)]
    for source in sources:
        Location(f"{bucket}/logs/{source.name}").write(source.read_bytes())
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    done = batch(f"{bucket}/out", f"{bucket}/logs/*.mcap", env=os.environ)
    assert done.returncode == 0, done.stdout + done.stderr
    for source in sources:
        log_id, frames, objects = single(source, tmp_path)
        assert table(bucket, METRICS, log_id, tmp_path).equals(frames)
        assert table(bucket, OBJECTS, log_id, tmp_path).equals(objects)
    assert batch(f"{bucket}/out", f"{bucket}/logs/").stdout.startswith("0 logs done, 2 skipped")
