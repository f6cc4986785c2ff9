"""A batch whose logs and dataset are in an object store: a real server."""

import polars as pl

from roadperc_stream.batch.storage.location import Location
from roadperc_stream.schemas.columns import TIME_COLUMNS
from tests.batch.dataset import METRICS, OBJECTS, batch, single, write_log


def table(bucket, kind, log_id, tmp_path):
    """The rows of a log, as the store has them."""
    (file,) = (file for file in Location(f"{bucket}/out/{kind}").files(".parquet").values() if log_id in file.address)
    copy = tmp_path / "table.parquet"
    Location(file.address).fetch(copy)
    return pl.read_parquet(copy).drop("config", *TIME_COLUMNS, strict=False)


def test_logs_and_dataset_in_a_store(tmp_path, bucket, monkeypatch):
    drives = [write_log(tmp_path / "in" / f"{number}.mcap", lane_m=0.05 * number) for number in range(3)]
    for source in drives:
        Location(f"{bucket}/drives/{source.name}").write(source.read_bytes())
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    done = batch(f"{bucket}/out", f"{bucket}/drives/*.mcap")
    assert done.returncode == 0, done.stdout + done.stderr
    for source in drives:
        log_id, frames, objects = single(source, tmp_path)
        assert table(bucket, METRICS, log_id, tmp_path).equals(frames)
        assert table(bucket, OBJECTS, log_id, tmp_path).equals(objects)
    again = batch(f"{bucket}/out", f"{bucket}/drives/")
    assert again.stdout.startswith("0 logs done, 3 left")
