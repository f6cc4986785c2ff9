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


@pytest.fixture
def task(tmp_path):
    (tmp_path / "scratch").mkdir()
    return task_of(write_log(tmp_path / "in" / "a.mcap"), tmp_path / "out", tmp_path / "scratch")


@pytest.mark.parametrize("fault", ["link", "file", "another user's", "mode 755"])
def test_a_scratch_folder_that_is_not_private_is_not_used(tmp_path, task, fault, monkeypatch):
    folder = tmp_path / "scratch" / NAME
    if fault == "link":
        folder.symlink_to(tmp_path / "in")
    elif fault == "file":
        folder.touch(mode=0o700)
    else:
        folder.mkdir()
        folder.chmod(0o755 if fault == "mode 755" else 0o700)
    if fault == "another user's":
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    problem = f"{folder}: expected a folder of this user with mode 700; remove it, or name another with --scratch"
    assert (attempt(task).error, work(task, no_progress).error) == (problem, problem)
    refused = batch(tmp_path / "out", tmp_path / "in", "--scratch", tmp_path / "scratch")
    assert (refused.returncode, refused.stderr) == (1, f"error: {problem}\n")


@pytest.mark.parametrize("mask", [0, 0o077])
def test_a_scratch_folder_is_made_for_its_user_alone(tmp_path, task, mask):
    before = os.umask(mask)
    try:
        assert work(task, no_progress).status == "done"
    finally:
        os.umask(before)
    folder = tmp_path / "scratch" / NAME
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert list((tmp_path / "scratch").iterdir()) == [folder] == list(scratch_of(task).parents)[1:2]


def test_the_scratch_folder_of_a_store_is_in_the_folder_for_temporary_files(tmp_path, bucket, monkeypatch):
    source = write_log(tmp_path / "in" / "a.mcap")
    with TemporaryDirectory() as short:  # pytest's path is too long for sockets
        monkeypatch.setenv("TMPDIR", short)
        folder = Path(short) / NAME
        done = batch(f"{bucket}/out", source, env=os.environ)
        assert done.returncode == 0, done.stdout + done.stderr
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
