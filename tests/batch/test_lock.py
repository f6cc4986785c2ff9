"""One batch at a time writes a dataset, on a disk and in a store."""

import os
import signal
import socket
import subprocess
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from threading import Barrier, Semaphore, get_ident

import msgspec
import pytest

from roadperc_stream.batch.location import Location
from roadperc_stream.batch.lock import LOCK, LockHolder, dataset_lock
from roadperc_stream.errors import StorageError
from tests.batch.dataset import batch, statuses, write_log
from tests.batch.machines import wait_until
from tests.commands import words


def test_a_second_batch_ends_with_an_error_that_names_the_first(tmp_path):
    out, folder = tmp_path / "out", tmp_path / "in"
    for number in range(2):
        write_log(folder / f"{number}.mcap", frames=10, lane_m=0.03 * number)
    with subprocess.Popen(words("roadperc-batch", out, folder, "--jobs", "1"), stdout=subprocess.DEVNULL) as first:
        wait_until(lambda: (out / LOCK).exists() or first.poll() is not None, 120)
        first.send_signal(signal.SIGSTOP)
        second = batch(out, folder)
        plan = batch(out, folder, "--dry-run")
        first.send_signal(signal.SIGCONT)
        who = f"host {socket.gethostname()}, process {first.pid}, started "
    assert (second.returncode, second.stdout, second.stderr.count("\n")) == (1, "", 1)
    assert second.stderr.startswith(f"error: {out}: another batch writes this dataset: {who}20")
    assert second.stderr.endswith(" UTC; wait until it ends\n")
    assert (plan.returncode, plan.stdout.count("is new")) == (0, 3)
    assert first.returncode == 0
    assert statuses(out) == {f"{number}.mcap": "done" for number in range(2)}
    assert not (out / LOCK).exists()


@pytest.mark.parametrize(
    ("host", "process", "age_s", "refusal"),
    [
        (socket.gethostname(), os.getpid(), 0, "wait until it ends$"),
        ("elsewhere", os.getpid(), 0, "wait until it ends; if it was killed, remove .*/.lock$"),
        (socket.gethostname(), os.getpid(), -1000, ""),  # another process had this number
        (socket.gethostname(), 2**22 + 1, 0, ""),
    ],
    ids=["running", "on another host", "of an earlier process", "ended"],
)
def test_the_lock_of_a_batch_that_has_ended_is_replaced(place, host, process, age_s, refusal):
    out = Location(place)
    other = LockHolder(host, process, LockHolder.me().created_s + age_s)
    out.at(LOCK).write(msgspec.json.encode(other))
    if refusal:
        with pytest.raises(StorageError, match=rf"process {process}, started .* UTC; {refusal}"), dataset_lock(out):
            pass
        assert msgspec.json.decode(out.at(LOCK).read(), type=LockHolder) == other
        return
    with dataset_lock(out):
        assert msgspec.json.decode(out.at(LOCK).read(), type=LockHolder) == LockHolder.me()
    assert out.at(LOCK).read() is None


@pytest.mark.parametrize("killed", [False, True], ids=["no lock", "lock of a killed batch"])
def test_of_batches_that_start_together_one_runs(tmp_path, monkeypatch, killed):
    """The first one stays until the others have ended."""
    together, ended, ran, me = Barrier(8), Semaphore(0), [], LockHolder.me()
    monkeypatch.setattr(LockHolder, "me", lambda: replace(me, created_s=me.created_s + get_ident() % 997 / 1000))

    def start(out):
        together.wait()
        with suppress(StorageError), dataset_lock(out):
            ran.append(out)
            assert all(ended.acquire(timeout=30) for _ in range(7))
        ended.release()

    for number in range(10):
        out = Location(str(tmp_path / str(number)))
        if killed:
            out.at(LOCK).write(msgspec.json.encode(replace(me, process=2**22 + 1)))
        with ThreadPoolExecutor(8) as batches:
            list(batches.map(start, [out] * 8))
        assert ended.acquire(timeout=1)
        assert ran == [out]
        ran.clear()
        assert list(Path(out.address).iterdir()) == []


def test_a_batch_removes_only_its_own_lock(place):
    other = msgspec.json.encode(LockHolder("elsewhere", 1, 0.0))
    with dataset_lock(Location(place)):
        Location(place).at(LOCK).write(other)
    assert Location(place).at(LOCK).read() == other


def test_a_damaged_lock_is_replaced(place):
    Location(place).at(LOCK).write(b"rubbish")
    with dataset_lock(Location(place)):
        assert Location(place).at(LOCK).read() != b"rubbish"
