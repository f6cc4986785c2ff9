"""Paths and addresses."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.batch.addresses import is_address, natural, split_pattern, whole
from roadperc_stream.errors import StorageError


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("s3://bucket/logs/*.mcap", True),
        ("abfs://container@account.dfs.core.windows.net/a", True),
        ("file:///logs/a.mcap", False),
        ("FILE:///logs/a.mcap", False),
        ("/logs/a.mcap", False),
        ("a:b.mcap", False),
    ],
)
def test_an_address_begins_with_the_scheme_of_a_store(text, answer):
    assert is_address(text) is answer


def test_whole_addresses(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text, address in (
        ("a.mcap", str(tmp_path / "a.mcap")),
        ("b/../a.mcap", str(tmp_path / "a.mcap")),
        ("/logs/", "/logs"),
        ("/", "/"),
        ("file:///logs/a b%20.mcap", "/logs/a b%20.mcap"),
        ("FILE:///logs/a.mcap", "/logs/a.mcap"),
        ("file://localhost/logs/a.mcap", "/logs/a.mcap"),
        ("s3://bucket/a%20b?c#d//", "s3://bucket/a%20b?c#d"),
        ("S3://bucket/", "s3://bucket"),
    ):
        assert whole(text) == address


@pytest.mark.parametrize("text", ["", "s3://", "s3:///", "a\0b"])
def test_a_text_without_a_name_is_refused(text):
    with pytest.raises(StorageError, match="expected the path or the address of a file or a folder"):
        whole(text)


@pytest.mark.parametrize("text", ["file://host/logs", "file://localhosts/logs", "file://logs", "file://"])
def test_a_file_of_another_machine_is_refused(text):
    with pytest.raises(StorageError, match=f"^{text}: expected a file of this machine, such as file:///"):
        whole(text)


def test_where_a_pattern_begins():
    assert split_pattern("s3://bucket/logs/20*/**/*.mcap") == ("s3://bucket/logs", "20*/**/*.mcap")
    assert split_pattern("/a/b.mcap") == ("/a/b.mcap", "")
    assert split_pattern("/*.mcap") == ("/", "*.mcap")


def test_numbers_sort_by_their_value():
    names = ["log10", "log2", "log2b", "log02", "Drive1", "a", "log", "9", "²"]
    assert sorted(names, key=natural) == ["9", "Drive1", "a", "log", "log02", "log2", "log2b", "log10", "²"]


@given(st.data())
def test_any_names_have_one_order(data):
    names = data.draw(st.lists(st.text(max_size=8), max_size=8))
    assert sorted(data.draw(st.permutations(names)), key=natural) == sorted(names, key=natural)
