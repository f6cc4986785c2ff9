"""A batch whose logs and dataset are in an object store: a real server."""

import polars as pl
import pytest

from roadperc_stream.batch.storage.location import Location
from roadperc_stream.schemas.columns import TIME_COLUMNS
from tests.batch.dataset import METRICS, OBJECTS, batch, single, write_log


@pytest.fixture
def drives(tmp_path, bucket):
    """Three logs on the disk and, below ``bucket``/drives, in the store."""
    return [write_log(tmp_path / "in" / f"{number}.mcap", lane_m=0.05 * number) for number in range(3)]


def upload(server, bucket, files):
    for file in files:
        server.send("PUT", f"{bucket.removeprefix('s3://')}/drives/{file.name}", file.read_bytes())


def table(server, bucket, kind, log_id, tmp_path):
    """The rows of a log, as the store has them."""
    (file,) = (file for file in Location(f"{bucket}/out/{kind}").files(".parquet").values() if log_id in file.address)
    copy = tmp_path / "table.parquet"
    Location(file.address).fetch(copy)
    return pl.read_parquet(copy).drop("config", *TIME_COLUMNS, strict=False)


def test_logs_and_dataset_in_a_store(tmp_path, s3_server, bucket, drives, monkeypatch):
    upload(s3_server, bucket, drives)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    done = batch(f"{bucket}/out", f"{bucket}/drives/*.mcap")
    assert done.returncode == 0, done.stdout + done.stderr
    for source in drives:
        log_id, frames, objects = single(source, tmp_path)
        assert table(s3_server, bucket, METRICS, log_id, tmp_path).equals(frames)
        assert table(s3_server, bucket, OBJECTS, log_id, tmp_path).equals(objects)
    again = batch(f"{bucket}/out", f"{bucket}/drives/")
    assert again.stdout.startswith("0 logs done, 3 left")


def test_a_log_that_is_gone_from_the_store_is_a_row(tmp_path, s3_server, bucket, drives):
    upload(s3_server, bucket, drives)
    listed = tmp_path / "list.txt"
    listed.write_text(f"{bucket}/drives/0.mcap\n{bucket}/none/\n")
    missing = batch(tmp_path / "out", f"@{listed}")
    assert missing.returncode == 1
    assert f"{bucket}/none" in missing.stderr
    assert missing.stderr.count("\n") == 1
