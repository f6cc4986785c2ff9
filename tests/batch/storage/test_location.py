"""Writing: files appear whole or not at all, on a disk and in stores."""

import errno
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path
from uuid import uuid4

import pytest
from fsspec.implementations.memory import MemoryFile
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from roadperc_stream.batch.storage import stores
from roadperc_stream.batch.storage.location import Location
from roadperc_stream.errors import RoadpercError, StorageError
from tests.object_store import BreakingProxy

BIG = os.urandom(1 << 20) * 17
"""More than one piece."""
NAME = "date=2024-05-01/ä b?[1]%20.parquet"


def test_written_files_are_read(place):
    folder = Location(place)
    assert folder.at(NAME).read() is None
    for data in (b"first", b"", b"second"):
        folder.at(NAME).write(data)
        assert folder.at(NAME).read() == data
    folder.at(NAME).remove()
    folder.at(NAME).remove()
    assert folder.at(NAME).read() is None


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30)
@given(name=st.lists(st.text("aä .%?*[]=+&#", min_size=1, max_size=6), min_size=1, max_size=3).map("/".join))
def test_any_name_below_the_folder_is_its_own(place, name):
    folder = Location(f"{place}/{uuid4().hex}")
    assume(not {".", ".."} & set(name.split("/")))
    folder.at(name).write(name.encode())
    assert folder.at(name).read() == name.encode()
    folder.at(name).remove()
    assert folder.at(name).read() is None


def test_a_file_is_moved_into_a_folder(place, tmp_path):
    folder, source = Location(place), tmp_path / "source"
    for data in (BIG, b"", b"short"):
        source.write_bytes(data)
        folder.at(NAME).put(source)
        assert folder.at(NAME).read() == data
        assert not source.exists()


def test_files_are_listed_by_name(place):
    folder = Location(place)
    assert folder.files("") == {}
    names = ["log/a.txt", "runs.parquet", "runs/9.parquet", "runs/10.parquet"]
    for name in (*reversed(names), "runs/.part.parquet", ".x/a.parquet"):
        folder.at(name).write(b"four")
    assert list(folder.files("")) == names
    assert list(folder.at("runs").files(".parquet")) == ["9.parquet", "10.parquet"]
    assert {stored.size_bytes for stored in folder.files("").values()} == {4}


def test_many_writers_of_one_name_leave_one_whole_file(place):
    folder = Location(place)
    texts = [bytes([k]) * 300_000 for k in range(8)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda text: folder.at("runs.parquet").write(text), texts * 3))
    assert folder.at("runs.parquet").read() in texts
    assert len(folder.files("")) == 1
    if folder.is_local:
        assert [path.name for path in Path(folder.address).iterdir()] == ["runs.parquet"]


def test_a_file_of_another_disk_is_copied(tmp_path, monkeypatch):
    source, replace = tmp_path / "source", Path.replace

    def refused(self, target):
        if self == source:
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", refused)
    source.write_bytes(b"data")
    Location(str(tmp_path / "out")).at("a").put(source)
    assert (tmp_path / "out" / "a").read_bytes() == b"data"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_an_error_of_the_disk_is_one_line(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    with pytest.raises(RoadpercError, match=r"file/a: (Not a directory|File exists)"):
        Location(str(tmp_path / "file")).at("a").write(b"")
    with pytest.raises(RoadpercError, match="folder: is a folder"):
        Location(str(tmp_path)).at("folder").write(b"")
    with pytest.raises(StorageError, match="folder: Is a directory"):
        Location(str(tmp_path)).at("folder").read()
    assert Location(str(tmp_path / "file")).at("a").read() is None


def test_an_upload_goes_on_after_a_broken_connection(bucket, s3_server, tmp_path, monkeypatch):
    (tmp_path / "source").write_bytes(BIG)
    with BreakingProxy(s3_server.port, after_bytes=1_000_000, breaks=2) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        Location(bucket).at(NAME).put(tmp_path / "source")
        assert proxy.breaks == 0
        assert Location(bucket).at(NAME).read() == BIG


def test_a_failed_upload_keeps_the_earlier_file(bucket, s3_server, tmp_path, monkeypatch):
    monkeypatch.setattr("roadperc_stream.batch.storage.location.WAITS_S", (0.0,))
    Location(bucket).at("a").write(b"before")
    (tmp_path / "source").write_bytes(BIG)
    with BreakingProxy(s3_server.port, after_bytes=1_000_000, breaks=10**6) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        with pytest.raises(StorageError, match=f"^{bucket}/a: .*UploadPart"):
            Location(bucket).at("a").put(tmp_path / "source")
    monkeypatch.setenv("AWS_ENDPOINT_URL", s3_server.url)
    assert Location(bucket).at("a").read() == b"before"
    assert (tmp_path / "source").read_bytes() == BIG


def test_a_failed_upload_to_another_store_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr("roadperc_stream.batch.storage.location.WAITS_S", ())
    sent = []

    def refused(self, data):
        sent.append(data)
        if len(sent) > 1:
            raise OSError("the store is full")
        return BytesIO.write(self, data)

    monkeypatch.setattr(MemoryFile, "write", refused, raising=False)
    (tmp_path / "source").write_bytes(BIG)
    target = Location(f"memory://{uuid4().hex}/a")
    with pytest.raises(StorageError, match="the store is full"):
        target.put(tmp_path / "source")
    assert target.read() is None
    assert (tmp_path / "source").exists()


def test_an_upload_needs_memory_for_one_piece(bucket, tmp_path):
    code = f"""
import resource
from pathlib import Path
from roadperc_stream.batch.storage.location import Location
folder = Location({bucket!r})
folder.at("a").write(bytes(1 << 24))
before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
folder.at("b").put(Path({str(tmp_path / "source")!r}))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb)
"""
    (tmp_path / "source").write_bytes(BIG * 6)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert int(done.stdout) < 64 << 10


def test_an_interrupted_upload_makes_no_file(bucket, tmp_path, monkeypatch):
    def pieces(path):
        yield b"x" * 6_000_000
        raise KeyboardInterrupt

    monkeypatch.setattr(stores, "pieces_of", pieces)
    (tmp_path / "source").write_bytes(BIG)
    with pytest.raises(KeyboardInterrupt):
        Location(bucket).at("a").put(tmp_path / "source")
    assert Location(bucket).files("") == {}
    assert (tmp_path / "source").exists()
