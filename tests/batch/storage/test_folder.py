"""A folder of results: what is written appears whole or not at all, wherever it is."""

import errno
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from uuid import uuid4

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from roadperc_stream.batch.storage.folder import Folder
from roadperc_stream.errors import StorageError, TargetError
from tests.object_store import BreakingProxy

BIG = os.urandom(1 << 20) * 24
"""More than one piece."""
NAME = "date=2024-05-01/ä b?[1]%20.parquet"


def test_what_was_written_is_read(place):
    folder = Folder(place)
    assert folder.read(NAME) is None
    for data in (b"first", b"", b"second"):
        folder.write(NAME, data)
        assert folder.read(NAME) == data
    folder.remove(NAME)
    folder.remove(NAME)
    assert folder.read(NAME) is None


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30)
@given(name=st.lists(st.text("aä .%?*[]=+&#", min_size=1, max_size=6), min_size=1, max_size=3).map("/".join))
def test_any_name_below_the_folder_is_its_own(place, name):
    folder = Folder(f"{place}/{uuid4().hex}")
    assume(not {".", ".."} & set(name.split("/")))
    folder.write(name, name.encode())
    assert folder.read(name) == name.encode()
    folder.remove(name)
    assert folder.read(name) is None


def test_a_file_is_moved_into_it(place, tmp_path):
    folder, source = Folder(place), tmp_path / "source"
    for data in (BIG, b"", b"short"):
        source.write_bytes(data)
        folder.put(source, NAME)
        assert folder.read(NAME) == data
        assert not source.exists()


def test_its_files_are_listed_and_named(place):
    folder = Folder(place)
    assert folder.files() == []
    for name in (
        "runs.parquet",
        "runs/10.parquet",
        "runs/9.parquet",
        "runs/.part.parquet",
        "log/a.txt",
        ".x/a.parquet",
    ):
        folder.write(name, b"four")
    assert [folder.name_of(s) for s in folder.files("runs", ".parquet")] == ["runs/9.parquet", "runs/10.parquet"]
    assert [folder.name_of(s) for s in folder.files(suffix=".txt")] == ["log/a.txt"]
    assert {s.size_bytes for s in folder.files()} == {4}
    assert folder.files("metrics", ".parquet") == []


def test_it_goes_to_other_processes(place):
    folder = Folder(place)
    folder.write("a", b"1")
    assert pickle.loads(pickle.dumps(folder)) == folder
    assert pickle.loads(pickle.dumps(folder)).read("a") == b"1"


def test_names_that_lead_out_are_refused(place, tmp_path):
    folder, source = Folder(place), tmp_path / "source"
    source.write_bytes(b"kept")
    for action in (
        lambda: folder.read("../a"),
        lambda: folder.write("/a", b""),
        lambda: folder.put(source, "a/../../b"),
        lambda: folder.remove(".."),
        lambda: folder.files(".."),
    ):
        with pytest.raises(StorageError, match="is not the name of a file below this folder"):
            action()
    assert source.read_bytes() == b"kept"


def test_only_files_below_it_have_a_name_there(place):
    folder = Folder(place)
    folder.write("a", b"")
    (stored,) = folder.files()
    with pytest.raises(StorageError, match="is not below"):
        Folder(f"{place}2").name_of(stored)


def test_a_path_is_of_this_machine(tmp_path):
    assert Folder(str(tmp_path)).path("a/b") == tmp_path / "a" / "b"
    with pytest.raises(StorageError, match="s3://bucket: expected a folder on this machine"):
        Folder("s3://bucket").path("a")


def test_many_writers_of_one_name_leave_one_whole_file(place):
    folder = Folder(place)
    texts = [bytes([k]) * 300_000 for k in range(8)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda text: folder.write("runs.parquet", text), texts * 3))
    assert folder.read("runs.parquet") in texts
    assert len(folder.files()) == 1
    if folder.is_local:
        assert [path.name for path in Path(folder.address).iterdir()] == ["runs.parquet"]


def test_what_is_being_written_is_hidden_and_has_one_name_per_writer(tmp_path, monkeypatch):
    hidden = []
    monkeypatch.setattr(Path, "write_bytes", lambda self, _: hidden.append(self) or self.touch())
    for _ in range(2):
        Folder(str(tmp_path)).write("a/b.parquet", b"1")
    assert len(set(hidden)) == 2
    assert all(path.parent == tmp_path / "a" and path.name.startswith(".b.parquet.") for path in hidden)


def test_a_file_of_another_disk_is_copied(tmp_path, monkeypatch):
    source, replace = tmp_path / "source", Path.replace

    def refused(self, target):
        if self == source:
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", refused)
    source.write_bytes(b"data")
    Folder(str(tmp_path / "out")).put(source, "a")
    assert (tmp_path / "out" / "a").read_bytes() == b"data"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_the_disk_refuses_is_one_line(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    with pytest.raises(TargetError, match=r"file/a: (Not a directory|File exists)"):
        Folder(str(tmp_path / "file")).write("a", b"")
    with pytest.raises(TargetError, match="folder: is a folder"):
        Folder(str(tmp_path)).write("folder", b"")
    with pytest.raises(StorageError, match="folder: Is a directory"):
        Folder(str(tmp_path)).read("folder")
    with pytest.raises(TargetError, match=r"/a: No such file"):
        Folder(str(tmp_path)).put(tmp_path / "missing", "a")
    assert Folder(str(tmp_path / "file")).read("a") is None


def test_an_upload_goes_on_after_a_broken_connection(bucket, s3_server, tmp_path, monkeypatch):
    (tmp_path / "source").write_bytes(BIG)
    with BreakingProxy(s3_server.port, after_bytes=1_000_000, breaks=2) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        Folder(bucket).put(tmp_path / "source", NAME)
        assert proxy.breaks == 0
        assert Folder(bucket).read(NAME) == BIG


def test_an_upload_that_fails_leaves_what_was_there(bucket, s3_server, tmp_path, monkeypatch):
    monkeypatch.setattr("roadperc_stream.batch.storage.stores.WAITS_S", (0.0,))
    Folder(bucket).write("a", b"before")
    (tmp_path / "source").write_bytes(BIG)
    with BreakingProxy(s3_server.port, after_bytes=1_000_000, breaks=10**6) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        with pytest.raises(StorageError, match=f"^{bucket}/a: .*UploadPart"):
            Folder(bucket).put(tmp_path / "source", "a")
    monkeypatch.setenv("AWS_ENDPOINT_URL", s3_server.url)
    assert Folder(bucket).read("a") == b"before"
    assert (tmp_path / "source").read_bytes() == BIG


def test_an_upload_takes_memory_for_a_piece_and_not_for_the_file(bucket, tmp_path):
    code = f"""
import resource
from pathlib import Path
from roadperc_stream.batch.storage.folder import Folder
folder = Folder({bucket!r})
folder.write("a", bytes(1 << 24))
before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
folder.put(Path({str(tmp_path / "source")!r}), "b")
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb)
"""
    (tmp_path / "source").write_bytes(BIG * 6)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert int(done.stdout) < 64 << 10


def test_an_upload_that_is_interrupted_makes_no_file(bucket, tmp_path, monkeypatch):
    def pieces(path):
        yield b"x" * 6_000_000
        raise KeyboardInterrupt

    monkeypatch.setattr("roadperc_stream.batch.storage.stores.pieces_of", pieces)
    (tmp_path / "source").write_bytes(BIG)
    with pytest.raises(KeyboardInterrupt):
        Folder(bucket).put(tmp_path / "source", "a")
    assert Folder(bucket).files() == []
    assert (tmp_path / "source").exists()
