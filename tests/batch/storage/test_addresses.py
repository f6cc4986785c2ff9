"""Paths, addresses and patterns; patterns match the files that Python's glob finds."""

import glob
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from roadperc_stream.batch.storage.addresses import is_address, natural, remainders, split_pattern, whole
from roadperc_stream.errors import StorageError

NAMES = st.sampled_from(["a", "b2", "b10", ".h", "x.mcap", ".y.mcap", "[1]", "ä b"])
PATHS = st.lists(NAMES, min_size=1, max_size=4).map(tuple)
PATTERN_PARTS = st.sampled_from(["*", "**", "a", "b?", "b*", "*.mcap", ".*", "[ab]*", "[!a]*", ".h", "[[]1]", "*2"])
PATTERNS = st.lists(PATTERN_PARTS, min_size=1, max_size=4).map(tuple)


def files_of(paths):
    """The paths without those that are folders of others."""
    return {path for path in paths if not any(other[: len(path)] == path for other in paths if other != path)}


def found_by_glob(root, pattern):
    """The files that glob finds, and the files in the folders that it finds."""
    for found in glob.glob("/".join(pattern), root_dir=root, recursive=True):  # noqa: PTH207 - the one that can
        if (root / found).is_file() and not found.endswith("/"):  # glob takes a file for a folder before "**"
            yield tuple(Path(found).parts)
        for below in (root / found).rglob("*"):
            names = below.relative_to(root / found).parts
            if below.is_file() and not any(name.startswith(".") for name in names):
                yield below.relative_to(root).parts


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


@given(paths=st.sets(PATHS, max_size=12), pattern=PATTERNS)
@example(paths={("a", "a", ".h")}, pattern=("*", "*", ".h", "**"))
def test_a_pattern_matches_the_files_of_glob(tmp_path_factory, paths, pattern):
    root = tmp_path_factory.mktemp("tree")
    files = files_of(paths)
    for names in files:
        root.joinpath(*names).parent.mkdir(parents=True, exist_ok=True)
        root.joinpath(*names).touch()
    assert {names for names in files if () in remainders(pattern, names)} == set(found_by_glob(root, pattern))


@given(names=PATHS, pattern=PATTERNS)
def test_every_folder_of_a_match_is_entered(names, pattern):
    if () in remainders(pattern, names):
        assert all(remainders(pattern, names[:depth]) for depth in range(len(names)))


def test_folders_without_a_match_are_skipped():
    assert not remainders(("*.mcap",), ("2024",))
    assert not remainders(("2024", "*.mcap"), ("2025",))
    assert not remainders(("**", "*.mcap"), (".git",))
    assert not remainders((), ("a", ".git"))
    assert remainders(("**", "*.mcap"), ("2024", "5"))


def test_where_a_pattern_begins():
    assert split_pattern("s3://bucket/logs/20*/**/*.mcap") == ("s3://bucket/logs", ("20*", "**", "*.mcap"))
    assert split_pattern("s3://bucket/*") == ("s3://bucket", ("*",))
    assert split_pattern("/a/b.mcap") == ("/a/b.mcap", ())
    assert split_pattern("/*.mcap") == ("/", ("*.mcap",))


def test_numbers_sort_by_their_value():
    names = ["log10", "log2", "log2b", "log02", "Drive1", "a", "log", "9", "²"]
    assert sorted(names, key=natural) == ["9", "Drive1", "a", "log", "log02", "log2", "log2b", "log10", "²"]


@given(st.data())
def test_any_names_have_one_order(data):
    names = data.draw(st.lists(st.text(max_size=8), max_size=8))
    assert sorted(data.draw(st.permutations(names)), key=natural) == sorted(names, key=natural)
