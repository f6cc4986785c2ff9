"""A batch whose logs and dataset are in an object store: a real server, and a connection to it that breaks."""

import polars as pl
import pytest

from roadperc_stream.batch.configuration import BatchConfiguration
from roadperc_stream.batch.splitting import SplitPart
from roadperc_stream.batch.task import DriveFiles, Task
from roadperc_stream.batch.worker import work
from roadperc_stream.core.config import load_config
from roadperc_stream.core.progress import no_progress
from roadperc_stream.log import writing
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.storage import fetching
from roadperc_stream.storage.finding import find_files
from roadperc_stream.storage.folder import Folder
from tests.batch.dataset import METRICS, OBJECTS, batch, runs, single, tables, write_log
from tests.object_store import BreakingProxy, environment_of


@pytest.fixture
def drives(tmp_path, bucket):
    """Three logs on the disk and, below ``bucket``/drives, in the store."""
    return [write_log(tmp_path / "in" / f"{number}.mcap", lane_m=0.05 * number) for number in range(3)]


def upload(server, bucket, files):
    for file in files:
        server.send("PUT", f"{bucket.removeprefix('s3://')}/drives/{file.name}", file.read_bytes())


def table(server, bucket, kind, log_id, tmp_path):
    """The rows of a log, as the store has them."""
    out = Folder(f"{bucket}/out")
    (file,) = (file for file in out.files(kind, ".parquet") if log_id in file.address)
    copy = tmp_path / "table.parquet"
    copy.write_bytes(out.read(out.name_of(file)))
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


def test_a_connection_that_is_cut_in_the_middle(tmp_path, s3_server, bucket, drives, monkeypatch):
    upload(s3_server, bucket, drives)
    size = drives[0].stat().st_size
    with BreakingProxy(s3_server.port, after_bytes=size // 2, breaks=3) as proxy:
        for name, value in environment_of(proxy.url).items():
            monkeypatch.setenv(name, value)
        done = batch(f"{bucket}/out", f"{bucket}/drives/")
        assert proxy.breaks == 0
    assert done.returncode == 0, done.stdout + done.stderr
    for source in drives:
        log_id, frames, _ = single(source, tmp_path)
        with pytest.MonkeyPatch.context() as patch:
            for name, value in environment_of(s3_server.url).items():
                patch.setenv(name, value)
            assert table(s3_server, bucket, METRICS, log_id, tmp_path).equals(frames)


def test_a_log_that_is_gone_from_the_store_is_a_row(tmp_path, s3_server, bucket, drives):
    upload(s3_server, bucket, drives)
    listed = tmp_path / "list.txt"
    listed.write_text(f"{bucket}/drives/0.mcap\n{bucket}/none/\n")
    missing = batch(tmp_path / "out", f"@{listed}")
    assert missing.returncode == 1
    assert f"{bucket}/none" in missing.stderr
    assert missing.stderr.count("\n") == 1


@pytest.mark.parametrize("asked", ["--split 3 --warm-up 1", "--end 2.5"])
def test_of_a_log_in_a_store_each_part_is_fetched_alone(tmp_path, s3_server, bucket, asked):
    """The tables are those of a batch over the log on the disk."""
    source = write_log(tmp_path / "long.mcap", frames=160)
    upload(s3_server, bucket, [source])
    for out, given in ((f"{bucket}/out", f"{bucket}/drives/"), (str(tmp_path / "out"), source)):
        done = batch(out, given, *asked.split())
        assert done.returncode == 0, done.stdout + done.stderr
    (row,) = runs(tmp_path / "out").to_dicts()
    for kind in (METRICS, OBJECTS):
        assert table(s3_server, bucket, kind, row["log_id"], tmp_path).equals(
            tables(tmp_path / "out", kind, row["log_id"])
        )


def test_a_part_of_a_log_brings_its_own_bytes_alone(tmp_path, s3_server, bucket, monkeypatch):
    monkeypatch.setattr(writing, "CHUNK_SIZE_BYTES", 100_000)
    source = write_log(tmp_path / "long.mcap", frames=400)
    upload(s3_server, bucket, [source])
    monkeypatch.setattr(fetching, "_BLOCK_BYTES", 4 << 10)
    (file,) = find_files(f"{bucket}/drives/")
    with BreakingProxy(s3_server.port, after_bytes=1, breaks=0) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        task = Task(
            DriveFiles((file,)),
            BatchConfiguration(load_config(None), split_s=5.0, warm_up_s=1.0),
            Folder(str(tmp_path / "out")),
            piece=SplitPart(1, 5.0, 10.0, shared_frames=3),
            is_audited=True,
        )
        assert work(task, no_progress).frames == 100
        assert proxy.brought_bytes < 0.7 * file.size_bytes
