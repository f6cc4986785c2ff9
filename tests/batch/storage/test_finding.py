"""The files of folders and patterns, on a disk and in stores."""

import errno
import os
from pathlib import Path

import pytest

from roadperc_stream.batch.storage.location import Location, find_files
from roadperc_stream.errors import StorageError

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
        ("/.a*/*", [".a/t.mcap"]),
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


def test_size_and_fingerprint_are_of_the_content(logs):
    (before,) = find_files(f"{logs.address}/log2.mcap")
    (listed,) = find_files(f"{logs.address}/log2.*")
    assert before == listed
    assert before.size_bytes == len(b"log2.mcap")
    logs.at("log2.mcap").write(b"longer than before")
    (after,) = find_files(f"{logs.address}/log2.*")
    assert after.fingerprint != before.fingerprint
    assert after.size_bytes == len(b"longer than before")


def test_links_are_followed_but_not_in_circles(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "a.mcap").write_bytes(b"log")
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "linked").symlink_to(tmp_path / "disk")
    (tmp_path / "logs" / "dead.mcap").symlink_to(tmp_path / "nowhere")
    (tmp_path / "disk" / "up").symlink_to(tmp_path / "logs")
    logs = tmp_path / "logs"
    found = {stored.address: stored.size_bytes for stored in find_files(str(logs))}
    assert found == {str(logs / "dead.mcap"): 0, str(logs / "linked" / "a.mcap"): 3}


def test_a_link_to_a_folder_above_the_one_that_is_searched_is_followed(tmp_path):
    logs = tmp_path / "disk" / "logs"
    logs.mkdir(parents=True)
    (tmp_path / "disk" / "a.mcap").write_bytes(b"log")
    (logs / "all").symlink_to(tmp_path / "disk")
    assert [stored.address for stored in find_files(str(logs))] == [str(logs / "all" / "a.mcap")]


def test_pipes_are_not_found(tmp_path):
    os.mkfifo(tmp_path / "pipe.mcap")
    for path in (tmp_path / "pipe.mcap", tmp_path):
        with pytest.raises(StorageError, match=r"no \.mcap file below it"):
            find_files(str(path))


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
