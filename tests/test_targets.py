"""Files that are written: what may be replaced, and that none appears half written."""

import re

import pytest

from roadperc_stream.errors import TargetError
from roadperc_stream.targets import completing, require_free, require_suffix


def test_a_free_name_may_be_written(tmp_path):
    require_free(tmp_path / "new" / "out.mp4", force=False, source=tmp_path / "in.mcap", suffix=".mp4")


@pytest.mark.parametrize("force", [False, True])
def test_what_must_never_be_written(tmp_path, force):
    source = tmp_path / "in.mcap"
    source.write_bytes(b"log")
    (tmp_path / "folder.mp4").mkdir()
    for target, suffix, why in (
        (tmp_path, ".mp4", "is a folder"),
        (tmp_path / "folder.mp4", ".mp4", "is a folder"),
        (tmp_path / "out.avi", ".mp4", "expected a name that ends in .mp4"),
        (tmp_path / "mp4", ".mp4", "expected a name that ends in .mp4"),
        (source, ".mp4", "expected a name that ends in .mp4"),
        (source, ".mcap", "is the input itself"),
        (tmp_path / "." / "in.mcap", ".mcap", "is the input itself"),
    ):
        with pytest.raises(TargetError, match=f"{re.escape(str(target))}: {why}"):
            require_free(target, force=force, source=source, suffix=suffix)


def test_an_existing_file_is_replaced_when_told_so_only(tmp_path):
    target = tmp_path / "out.mp4"
    target.write_bytes(b"old")
    require_free(target, force=True, suffix=".mp4")
    with pytest.raises(TargetError, match="exists already; --force replaces it"):
        require_free(target, force=False, suffix=".mp4")


def test_a_name_may_end_in_one_of_several_suffixes_however_it_is_spelled(tmp_path):
    for name in ("a.html", "a.HTM", "a.b.Html"):
        require_suffix(tmp_path / name, ".html", ".htm")
    with pytest.raises(TargetError, match=r"a\.mcap: expected a name that ends in \.html or \.htm$"):
        require_suffix(tmp_path / "a.mcap", ".html", ".htm")


def test_a_file_appears_when_it_is_complete(tmp_path):
    target = tmp_path / "new" / "out.mp4"
    with completing(target) as temporary:
        temporary.write_bytes(b"whole")
        assert temporary.suffix == ".mp4"
        assert not target.exists()
    assert target.read_bytes() == b"whole"
    assert list(target.parent.iterdir()) == [target]


def write_half(target):
    with completing(target) as temporary:
        temporary.write_bytes(b"half")
        raise KeyboardInterrupt


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    target = tmp_path / "file" / "out.mp4"
    with pytest.raises(TargetError, match=re.escape(f"{target}: ")):
        write_half(target)


def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "out.mp4"
    target.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        write_half(target)
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]
