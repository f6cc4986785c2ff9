"""Temporary files of a batch outside the dataset: in a private folder of the user, or one error."""

import os
import stat
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from roadperc_stream.batch.attempt import attempt
from roadperc_stream.batch.worker import scratch_of, work
from roadperc_stream.system.progress import no_progress
from tests.batch.dataset import batch, write_log
from tests.batch.test_again import task as task_of

NAME = f"roadperc-batch-{os.getuid()}"
STRANGER = 12345


FAULTS = {
    "link": "is a link or a file",
    "another user's": "belongs to user",
    "mode 755": "has mode 755",
}


def make_faulty(folder, fault, monkeypatch):
    if fault == "link":
        folder.symlink_to(folder.parent / "theirs")
        (folder.parent / "theirs").mkdir(mode=0o700)
    if fault.startswith("mode"):
        folder.mkdir()
        folder.chmod(int(fault[-3:], 8))
    if fault == "another user's":
        folder.mkdir(mode=0o700)
        if os.geteuid() == 0:
            os.chown(folder, STRANGER, -1)
        else:
            monkeypatch.setattr(os, "geteuid", lambda: STRANGER)


@pytest.fixture
def scratch(tmp_path):
    (tmp_path / "scratch").mkdir()
    return tmp_path / "scratch"


@pytest.fixture
def task(tmp_path, scratch):
    return task_of(write_log(tmp_path / "in" / "a.mcap"), tmp_path / "out", scratch)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_scratch_folder_that_is_not_private_is_not_used(tmp_path, task, scratch, fault, monkeypatch):
    make_faulty(scratch / NAME, fault, monkeypatch)
    before = below(scratch)
    for outcome in (attempt(task), work(task, no_progress)):
        assert outcome.status == "unreachable"
        assert outcome.error.startswith(f"{scratch / NAME}: {FAULTS[fault]}")
        assert outcome.error.endswith("; remove it, or name another folder with --scratch")
    refused = batch(tmp_path / "out", tmp_path / "in", "--scratch", scratch)
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)
    assert refused.stderr.startswith(f"error: {scratch / NAME}: {FAULTS[fault]}")
    assert below(scratch) == before


@pytest.mark.parametrize("mask", [0, 0o077])
def test_a_scratch_folder_is_made_for_its_user_alone(task, scratch, mask):
    before = os.umask(mask)
    try:
        assert work(task, no_progress).status == "done"
    finally:
        os.umask(before)
    assert stat.S_IMODE((scratch / NAME).stat().st_mode) == 0o700
    assert list(scratch.iterdir()) == [scratch / NAME] == list(scratch_of(task).parents)[1:2]


def test_the_scratch_folder_of_a_store_is_in_the_folder_for_temporary_files(tmp_path, bucket, monkeypatch):
    source = write_log(tmp_path / "in" / "a.mcap")
    with TemporaryDirectory() as short:  # pytest's path is too long for sockets
        monkeypatch.setenv("TMPDIR", short)
        folder = Path(short) / NAME
        done = batch(f"{bucket}/out", source, env=os.environ)
        assert done.returncode == 0, done.stdout + done.stderr
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def below(folder):
    return sorted((path, path.lstat().st_mode, path.lstat().st_uid) for path in folder.rglob("*"))
