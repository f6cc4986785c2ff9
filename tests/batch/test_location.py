"""Files are found, read, written and copied on a disk and in stores; errors are one line with the address."""

import errno
import glob
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path
from unittest.mock import Mock
from uuid import uuid4

import pytest
from fsspec.implementations.arrow import ArrowFile
from fsspec.implementations.memory import MemoryFile
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from roadperc_stream.batch.location import Location, find_files
from roadperc_stream.errors import RoadpercError, StorageError, TargetError
from tests.object_store import BreakingProxy

BIG = os.urandom(1 << 20) * 17
"""More than one piece."""
NAME = "date=2024-05-01/ä b?[1]%20#.mcap"


NAMES = ("a b/ä?[1]%20.mcap", "log10.mcap", "log2.mcap", "2024/5/x.MCAP", "2024/5/x.bag", ".a/t.mcap", ".p.mcap")


@pytest.fixture
def logs(place):
    folder = Location(place)
    for name in NAMES:
        folder.at(name).write(name.encode())
    return folder


def found(folder, pattern):
    return [stored.address.removeprefix(f"{folder.address}/") for stored in find_files(f"{folder.address}{pattern}")]


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("", ["2024/5/x.MCAP", "a b/ä?[1]%20.mcap", "log2.mcap", "log10.mcap"]),
        ("/2024", ["2024/5/x.MCAP"]),
        ("/*.mcap", ["log2.mcap", "log10.mcap"]),
        ("/*", ["2024/5/x.MCAP", "a b/ä?[1]%20.mcap", "log2.mcap", "log10.mcap"]),
        ("/log?.mcap", ["log2.mcap"]),
        ("/**/x.*", ["2024/5/x.MCAP"]),
        ("/20*", ["2024/5/x.MCAP"]),
        ("/a b/ä?[1]%20.mcap", ["a b/ä?[1]%20.mcap"]),
        ("/2024/5/x.bag", ["2024/5/x.bag"]),
        ("/.a/t.mcap", [".a/t.mcap"]),
    ],
)
def test_the_files_of_a_pattern(logs, pattern, names):
    assert found(logs, pattern) == names


@pytest.mark.parametrize(
    ("pattern", "why"),
    [
        ("/no", "no such file, and no .mcap file below it"),
        ("/log2.mcap/x", "no such file, and no .mcap file below it"),
        ("/no/*.mcap", "no .mcap file matches"),
        ("/*.bag", "no .mcap file matches"),
    ],
)
def test_nothing_found_is_an_error_with_the_address(logs, pattern, why):
    with pytest.raises(StorageError) as caught:
        find_files(f"{logs.address}{pattern}")
    assert str(caught.value) == f"{logs.address}{pattern}: {why}"


FOLDERS = st.sampled_from(["a", "b2", "b10", ".h", "[1]", "ä b"])
PATHS = st.tuples(st.lists(FOLDERS, max_size=3), st.sampled_from(["x.mcap", "b2.mcap", ".y.mcap"]))
PATTERN_PARTS = st.sampled_from(["*", "**", "a", "b?", "b*", "*.mcap", ".*", "[ab]*", "[!a]*", ".h", "[[]1]", "*2"])
PATTERNS = st.lists(PATTERN_PARTS, min_size=1, max_size=4).map("/".join)


def found_by_glob(root, pattern):
    """The files that glob finds, and the files in the folders that it finds, without hidden ones."""
    for name in glob.glob(pattern, root_dir=root, recursive=True):  # noqa: PTH207 - the one that can
        for path in (root / name, *(root / name).rglob("*")):
            names = path.relative_to(root).parts
            if path.is_file() and not any(name.startswith(".") for name in names):
                yield "/".join(names)


@settings(deadline=None)
@given(paths=st.sets(PATHS.map(lambda path: "/".join((*path[0], path[1]))), max_size=12), pattern=PATTERNS)
@example(paths={"a/a/.y.mcap", "a/b2.mcap"}, pattern="*/**")
def test_a_pattern_matches_the_files_of_glob(tmp_path_factory, paths, pattern):
    root = tmp_path_factory.mktemp("tree")
    for path in paths:
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).touch()
    assert set(Location(str(root)).files(".mcap", pattern)) == set(found_by_glob(root, pattern))


def test_size_and_fingerprint_are_of_the_content(logs):
    (before,) = find_files(f"{logs.address}/log2.mcap")
    (listed,) = find_files(f"{logs.address}/log2.*")
    assert (before, before.size_bytes) == (listed, len(b"log2.mcap"))
    logs.at("log2.mcap").write(b"longer than before")
    (after,) = find_files(f"{logs.address}/log2.*")
    assert after.fingerprint != before.fingerprint
    assert after.size_bytes == len(b"longer than before")


def test_links_are_followed_but_not_in_circles(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "a.mcap").write_bytes(b"log")
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "linked").symlink_to(tmp_path / "disk")
    (logs / "dead.mcap").symlink_to(tmp_path / "nowhere")
    (tmp_path / "disk" / "up").symlink_to(logs)
    os.mkfifo(logs / "pipe.mcap")
    found = {stored.address: stored.size_bytes for stored in find_files(str(logs))}
    assert found == {str(logs / "dead.mcap"): 0, str(logs / "linked" / "a.mcap"): 3}


def test_an_unreadable_folder_is_named(tmp_path, monkeypatch):
    (tmp_path / "closed").mkdir()
    listed = os.scandir

    def refused(folder):
        """The superuser may read everything, so the system does not refuse."""
        if Path(folder).name == "closed":
            raise PermissionError(errno.EACCES, "Permission denied", folder)
        return listed(folder)

    monkeypatch.setattr(os, "scandir", refused)
    with pytest.raises(StorageError, match=r"closed: Permission denied"):
        find_files(str(tmp_path))


@pytest.mark.parametrize("pattern", ["", "/*.mcap", "/**/*.mcap", "/*/*.mcap"])
def test_a_store_is_listed_once_and_not_asked_for_each_file(bucket, s3_server, pattern):
    for k in range(6):
        Location(bucket).at(f"logs/{k}.mcap").write(b"")
        Location(bucket).at(f"logs/day {k}/{k}.mcap").write(b"")
    before = len(s3_server.requests())
    assert len(find_files(f"{bucket}/logs{pattern}")) >= 6
    assert len(s3_server.requests()) - before <= 3


def test_written_files_are_read_listed_and_removed(place):
    folder = Location(place)
    assert (folder.at(NAME).read(), folder.files("")) == (None, {})
    for data in (b"first", b"", b"second"):
        folder.at(NAME).write(data)
        assert folder.at(NAME).read() == data
    assert {name: stored.size_bytes for name, stored in folder.files("").items()} == {NAME: 6}
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


def test_many_writers_of_one_name_leave_one_whole_file(place):
    folder = Location(place)
    texts = [bytes([k]) * 300_000 for k in range(8)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda text: folder.at("runs.parquet").write(text), texts * 3))
    assert folder.at("runs.parquet").read() in texts
    assert len(folder.files("")) == 1
    if folder.is_local:
        assert [path.name for path in Path(folder.address).iterdir()] == ["runs.parquet"]


@pytest.mark.parametrize("data", [b"", b"short", BIG], ids=["empty", "short", "big"])
def test_a_file_is_moved_there_and_fetched(place, tmp_path, data):
    folder, source, target = Location(place), tmp_path / "source", tmp_path / "new" / "log.mcap"
    source.write_bytes(data)
    folder.at(NAME).put(source)
    assert not source.exists()
    folder.at(NAME).fetch(target)
    assert target.read_bytes() == data
    assert [path.name for path in target.parent.iterdir()] == ["log.mcap"]


def test_a_missing_file_and_a_target_that_cannot_be_written(place, tmp_path):
    with pytest.raises(StorageError, match="no such file"):
        Location(f"{place}/none.mcap").fetch(tmp_path / "new" / "log.mcap")
    assert list((tmp_path / "new").iterdir()) == []
    Location(place).at(NAME).write(b"log")
    (tmp_path / "file").touch()
    with pytest.raises(TargetError, match=r"file/log\.mcap: (Not a directory|File exists)"):
        Location(f"{place}/{NAME}").fetch(tmp_path / "file" / "log.mcap")


@pytest.mark.parametrize("after", [BIG[::-1], BIG[:-1], b""], ids=["same size", "shorter", "empty"])
def test_a_file_that_changes_during_the_copy_is_an_error(place, tmp_path, monkeypatch, after):
    Location(place).at("a.mcap").write(BIG)
    copy = shutil.copyfileobj

    def changed(*arguments):
        copy(*arguments)
        time.sleep(0.01)
        Location(place).at("a.mcap").write(after)

    monkeypatch.setattr(shutil, "copyfileobj", changed)
    with pytest.raises(StorageError, match="changed while it was read"):
        Location(f"{place}/a.mcap").fetch(tmp_path / "new" / "log.mcap")
    assert list((tmp_path / "new").iterdir()) == []


def test_a_broken_connection_is_repeated(bucket, s3_server, tmp_path, monkeypatch):
    (tmp_path / "source").write_bytes(BIG)
    with BreakingProxy(s3_server.port, after_bytes=1_000_000, breaks=4) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        Location(bucket).at(NAME).put(tmp_path / "source")
        Location(bucket).at(NAME).fetch(tmp_path / "log.mcap")
        assert proxy.breaks == 0
    assert (tmp_path / "log.mcap").read_bytes() == BIG


def test_a_connection_that_always_breaks_is_an_error(bucket, s3_server, tmp_path, monkeypatch):
    Location(bucket).at(NAME).write(BIG)
    with BreakingProxy(s3_server.port, after_bytes=100_000, breaks=10**6) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        with pytest.raises(StorageError) as caught:
            Location(f"{bucket}/{NAME}").fetch(tmp_path / "log.mcap")
    assert str(caught.value).startswith(f"{bucket}/{NAME}: ")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


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


def test_a_failed_upload_keeps_the_earlier_file(bucket, s3_server, tmp_path, monkeypatch):
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


def errors_of(address, tmp_path):
    """The errors of finding, fetching, writing and listing in a broken store."""
    (tmp_path / "source").write_bytes(b"x")
    for action in (
        lambda: find_files(f"{address}/*.mcap"),
        lambda: find_files(f"{address}/a.mcap"),
        lambda: Location(f"{address}/a.mcap").fetch(tmp_path / "a.mcap"),
        lambda: Location(address).at("a").write(b"x"),
        lambda: Location(address).at("a").put(tmp_path / "source"),
        lambda: Location(address).files(""),
    ):
        with pytest.raises(StorageError) as caught:
            action()
        assert str(caught.value).startswith(address)
        assert "\n" not in str(caught.value)
        yield str(caught.value)


@pytest.mark.parametrize(
    ("endpoint", "why"),
    [("http://127.0.0.1:9", "Could not connect to server"), ("http://no-such.invalid", "Could not resolve host")],
)
def test_an_unreachable_store_is_an_error_within_seconds(bucket, tmp_path, monkeypatch, endpoint, why):
    monkeypatch.setenv("AWS_ENDPOINT_URL", endpoint)
    begin_s = time.monotonic()
    with pytest.raises(StorageError, match=why):
        find_files(f"{bucket}/*.mcap")
    assert time.monotonic() - begin_s < 20


def test_an_invalid_endpoint(bucket, monkeypatch):
    monkeypatch.setenv("AWS_ENDPOINT_URL", "ftp://127.0.0.1")
    with pytest.raises(StorageError, match="ftp"):
        find_files(f"{bucket}/*.mcap")


def test_a_missing_bucket_and_unknown_keys(bucket, s3_server, tmp_path):
    for text in errors_of(f"{bucket}-not", tmp_path):
        assert "NO_SUCH_BUCKET" in text or "no such file" in text
    with s3_server.checking_credentials():
        for text in errors_of(bucket, tmp_path):
            assert "ACCESS_DENIED" in text or "INVALID_ACCESS_KEY_ID" in text


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("nope://a", r"nope://a: fsspec knows no scheme nope://"),
        ("abfs://c/a", r"abfs://c/a: needs fsspec's package for abfs:// \(adlfs .*pip install"),
    ],
)
def test_a_scheme_without_a_package(address, why, monkeypatch):
    monkeypatch.setitem(sys.modules, "adlfs", None)
    with pytest.raises(StorageError, match=why):
        find_files(address)


def test_the_endpoint_for_this_service_comes_first(bucket, s3_server, monkeypatch):
    Location(bucket).at("a.mcap").write(b"")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", s3_server.url)
    assert len(find_files(bucket)) == 1


@pytest.mark.parametrize("end", ["", "os._exit(0)"])
def test_a_process_that_used_a_store_and_forked_ends(bucket, end):
    code = f"""
import os, sys, warnings
from roadperc_stream.batch.location import Location
warnings.simplefilter("ignore", DeprecationWarning)  # newer versions of Python warn of a fork with threads
place = Location({bucket!r})
place.at("a").write(b"1")
child = os.fork()
if child == 0:
    assert place.at("a").read() == b"1"
    {end or "pass"}
else:
    assert os.waitpid(child, 0)[1] == 0
    place.at("b").write(b"2")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert Location(bucket).at("b").read() == b"2"


def test_an_upload_needs_memory_for_one_piece(bucket, tmp_path):
    code = f"""
import resource
from pathlib import Path
from roadperc_stream.batch.location import Location
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
    monkeypatch.setattr(ArrowFile, "flush", Mock(side_effect=KeyboardInterrupt))
    (tmp_path / "source").write_bytes(BIG)
    with pytest.raises(KeyboardInterrupt):
        Location(bucket).at("a").put(tmp_path / "source")
    assert Location(bucket).files("") == {}
    assert (tmp_path / "source").exists()
