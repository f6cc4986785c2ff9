"""Files are fetched whole or not at all, over broken connections and while others write."""

import os

import pytest

from roadperc_stream.batch.storage import location
from roadperc_stream.batch.storage.location import Location
from roadperc_stream.errors import StorageError, TargetError
from tests.object_store import BreakingProxy

BIG = os.urandom(1 << 20) * 5
NAME = "a b/ä?[1]%20#.mcap"


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    monkeypatch.setattr(location, "PIECE_BYTES", 1 << 20)
    monkeypatch.setattr(location, "WAITS_S", (0.01,) * 5)


def names_in(folder):
    return [path.name for path in folder.iterdir()]


@pytest.mark.parametrize("data", [b"", b"short", BIG], ids=["empty", "short", "big"])
def test_a_file_is_fetched(place, tmp_path, data):
    Location(place).at(NAME).write(data)
    target = tmp_path / "new" / "log.mcap"
    for _ in range(2):
        Location(f"{place}/{NAME}").fetch(target)
        assert target.read_bytes() == data
    assert names_in(target.parent) == ["log.mcap"]


def test_a_missing_file_leaves_nothing(place, tmp_path):
    with pytest.raises(StorageError, match="no such file"):
        Location(f"{place}/none.mcap").fetch(tmp_path / "new" / "log.mcap")
    assert names_in(tmp_path / "new") == []


def test_a_target_that_cannot_be_written_is_named(place, tmp_path):
    Location(place).at(NAME).write(b"log")
    (tmp_path / "file").touch()
    with pytest.raises(TargetError, match=r"file/log\.mcap: (Not a directory|File exists)"):
        Location(f"{place}/{NAME}").fetch(tmp_path / "file" / "log.mcap")


@pytest.mark.parametrize(("after_bytes", "breaks"), [(500_000, 3), (100_000, 7)])
def test_a_broken_connection_is_continued(bucket, s3_server, tmp_path, monkeypatch, after_bytes, breaks):
    Location(bucket).at(NAME).write(BIG)
    with BreakingProxy(s3_server.port, after_bytes, breaks) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        Location(f"{bucket}/{NAME}").fetch(tmp_path / "log.mcap")
        assert proxy.breaks == 0
    assert (tmp_path / "log.mcap").read_bytes() == BIG


def test_fetched_pieces_are_not_fetched_again(bucket, s3_server, tmp_path, monkeypatch):
    Location(bucket).at(NAME).write(BIG)
    with BreakingProxy(s3_server.port, after_bytes=100_000, breaks=4, first_bytes=3_000_000) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        Location(f"{bucket}/{NAME}").fetch(tmp_path / "log.mcap")
        assert proxy.breaks == 0
        assert len(BIG) <= proxy.brought_bytes < len(BIG) + (1 << 20) + 1_000_000
    assert (tmp_path / "log.mcap").read_bytes() == BIG


def test_a_connection_that_always_breaks_is_an_error(bucket, s3_server, tmp_path, monkeypatch):
    Location(bucket).at(NAME).write(BIG)
    with BreakingProxy(s3_server.port, after_bytes=100_000, breaks=10**6) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        with pytest.raises(StorageError) as caught:
            Location(f"{bucket}/{NAME}").fetch(tmp_path / "log.mcap")
    assert str(caught.value).startswith(f"{bucket}/{NAME}: ")
    assert "\n" not in str(caught.value)
    assert names_in(tmp_path) == []


@pytest.mark.parametrize("after", [BIG[::-1], BIG[:-1], b""], ids=["same size", "shorter", "empty"])
def test_a_file_that_changes_during_the_copy_is_an_error(place, tmp_path, monkeypatch, after):
    Location(place).at("a.mcap").write(BIG)
    piece = location._piece

    def changed(*arguments, **options):
        Location(place).at("a.mcap").write(after)
        return piece(*arguments, **options)

    monkeypatch.setattr(location, "_piece", changed)
    with pytest.raises(StorageError, match="changed while it was read"):
        Location(f"{place}/a.mcap").fetch(tmp_path / "new" / "log.mcap")
    assert names_in(tmp_path / "new") == []
