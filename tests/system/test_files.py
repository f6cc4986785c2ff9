"""Output files: what may be replaced, and partial files."""

import os
import re
import subprocess
import sys

import pytest

from roadperc_stream.errors import TargetError
from roadperc_stream.system.files import (
    completing,
    not_a_log,
    remove_stale_partials,
    require_free,
    require_suffix,
)


@pytest.mark.parametrize("force", [False, True])
def test_inputs_folders_and_wrong_suffixes_are_refused(tmp_path, force):
    source = tmp_path / "in.mcap"
    source.write_bytes(b"log")
    (tmp_path / "folder.mp4").mkdir()
    for target, suffix, why in (
        (tmp_path, ".mp4", "is a folder"),
        (tmp_path / "folder.mp4", ".mp4", "is a folder"),
        (tmp_path / "out.avi", ".mp4", "expected a name that ends in .mp4"),
        (tmp_path / "mp4", ".mp4", "expected a name that ends in .mp4"),
        (source, ".mp4", "expected a name that ends in .mp4"),
        (source, ".mcap", "is the input; name another output"),
        (tmp_path / "." / "in.mcap", ".mcap", "is the input; name another output"),
    ):
        with pytest.raises(TargetError, match=f"{re.escape(str(target))}: {why}"):
            require_free(target, force=force, source=source, suffix=suffix)


def test_an_existing_file_is_replaced_only_with_force(tmp_path):
    target = tmp_path / "out.mp4"
    require_free(target, force=False, source=tmp_path / "in.mcap", suffix=".mp4")
    target.write_bytes(b"old")
    require_free(target, force=True, suffix=".mp4")
    with pytest.raises(TargetError, match=r"exists; pass --force to overwrite it"):
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


def test_an_error_keeps_the_old_file_and_leaves_no_partial_file(tmp_path):
    target = tmp_path / "out.mp4"
    target.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        write_half(target)
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def node(path, kind):
    """Make a pipe or a link, which a rename would replace."""
    if kind == "pipe":
        os.mkfifo(path)
    else:
        if kind == "link":
            path.with_name("real.mp4").write_bytes(b"old")
        path.symlink_to("real.mp4" if kind != "loop" else path.name)


@pytest.mark.parametrize(
    ("kind", "why"),
    [("pipe", "is a device or a pipe"), ("link", "is a link"), ("dangling", "is a link"), ("loop", "is a link")],
)
def test_pipes_and_links_are_not_replaced(tmp_path, kind, why):
    target = tmp_path / "out.mp4"
    node(target, kind)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(TargetError, match=re.escape(f"{target}: {why}")):
        require_free(target, force=True, suffix=".mp4")
    with pytest.raises(TargetError, match=why), completing(target):
        pytest.fail("nothing can be written")
    assert sorted(tmp_path.iterdir()) == before
    assert target.is_fifo() or target.is_symlink()


def test_a_name_that_is_not_utf8_is_refused(tmp_path):
    """The libraries that write files need text; one of them aborts without it."""
    target = tmp_path / os.fsdecode(b"out\xff.mp4")
    with pytest.raises(TargetError, match=r"out\\udcff\.mp4': expected a name in UTF-8"):
        require_free(target, force=True, suffix=".mp4")


def write_while_another_does(target, force):
    with completing(target, force=force) as temporary:
        temporary.write_bytes(b"mine")
        target.write_bytes(b"theirs")


def test_a_file_that_another_program_wrote_stays(tmp_path):
    target = tmp_path / "out.mp4"
    with pytest.raises(TargetError, match="written by another program; pass --force"):
        write_while_another_does(target, force=False)
    assert target.read_bytes() == b"theirs"
    write_while_another_does(target, force=True)
    assert target.read_bytes() == b"mine"
    assert list(tmp_path.iterdir()) == [target]


def dead_process():
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        return process.pid


def test_partial_files_of_ended_processes_are_removed(tmp_path):
    dead, target = dead_process(), tmp_path / "out.mcap"
    names = (f"{dead}.partial", f"{dead}.partial.mcap", f"{dead}.partial.html", f"{'9' * 30}.partial")
    left = [f".out.mcap.{name}" for name in names]
    kept = [
        f".out.mcap.{os.getppid()}.partial",  # of one that lives
        f".other.mcap.{dead}.partial",
        f".out.mcap.5.{dead}.partial",  # of the target out.mcap.5
        f"out.mcap.{dead}.partial",
        ".out.mcap.x.partial",
    ]
    for name in (*left, *kept):
        (tmp_path / name).write_bytes(b"")
    folder = tmp_path / f".out.mcap.{dead}.partial.x1"  # a scratch folder
    folder.mkdir()
    (folder / "log.mcap").touch()
    remove_stale_partials(target)
    assert {path.name for path in tmp_path.iterdir()} == set(kept)
    remove_stale_partials(tmp_path / "no folder" / "out.mcap")


def test_the_error_for_a_folder_names_the_first_log_in_it(tmp_path):
    for name in ("b.mcap", "a.mcap", "0.txt"):
        (tmp_path / name).touch()
    both = f", or all 2 files of one log: {tmp_path}/*.mcap"
    assert not_a_log(tmp_path) == f"{tmp_path}: is a folder, expected a log, such as {tmp_path / 'a.mcap'}{both}"
    (tmp_path / "b.mcap").unlink()
    assert not_a_log(tmp_path) == f"{tmp_path}: is a folder, expected a log, such as {tmp_path / 'a.mcap'}"


def test_the_error_for_a_dump_gives_the_command_that_converts_it(tmp_path):
    dump = tmp_path / "a drive"
    dump.mkdir()
    assert not_a_log(dump).endswith(f"convert frames or a dataset with: roadperc-convert '{dump}' '{dump}.mcap'")
