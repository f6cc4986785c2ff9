"""What is a path and what an address, and that no name leads out of its folder."""

from pathlib import Path

import pytest

from roadperc_stream.batch.storage.addresses import is_address, joined, whole
from roadperc_stream.errors import StorageError


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("s3://bucket/drives/*.mcap", True),
        ("GS://bucket", True),
        ("abfs://container@account.dfs.core.windows.net/a", True),
        ("file:///drives/a.mcap", False),
        ("/drives/a.mcap", False),
        ("a:b.mcap", False),
        ("drives/s3://a", False),
        ("", False),
    ],
)
def test_an_address_begins_with_the_scheme_of_a_store(text, answer):
    assert is_address(text) is answer


def test_whole_addresses(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text, address in (
        ("a.mcap", str(tmp_path / "a.mcap")),
        ("b/../a.mcap", str(tmp_path / "a.mcap")),
        ("/drives/", "/drives"),
        ("file:///drives/a%20b.mcap", "/drives/a b.mcap"),
        ("file://localhost/drives", "/drives"),
        ("s3://bucket/a%20b?c#d//", "s3://bucket/a%20b?c#d"),
        ("S3://bucket/", "s3://bucket"),
    ):
        assert whole(text) == address


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "expected the path or the address of a file, found an empty text"),
        ("s3://", "expected the name of a bucket behind s3://"),
        ("s3:///", "expected the name of a bucket behind s3://"),
        ("file://elsewhere/a", "expected a file of this machine"),
        ("a\0b", "zero byte"),
    ],
)
def test_what_names_nothing(text, why):
    with pytest.raises(StorageError, match=why):
        whole(text)


@pytest.mark.parametrize("name", ["", ".", "..", "../a", "a/../../b", "/a", "a//b", "a/", "./a", "a\\..\\b", "a\0"])
@pytest.mark.parametrize("folder", ["/out", "s3://bucket/out"])
def test_no_name_leads_out_of_its_folder(folder, name):
    with pytest.raises(StorageError, match="is not the name of a file below this folder"):
        joined(folder, name)


def test_names_are_joined():
    assert joined("s3://b/out", "date=1/ä b.parquet") == "s3://b/out/date=1/ä b.parquet"
    assert Path(joined("/", "...a")) == Path("/...a")
