"""One batch at a time writes a dataset, on a disk and in a store."""

import os
import re
import signal
import socket
import subprocess
import time
from contextlib import nullcontext

import msgspec
import pytest

from roadperc_stream.batch import dataset_lock
from roadperc_stream.batch.dataset_lock import LOCK, DatasetLock, LockHolder
from roadperc_stream.batch.driver import BatchRun
from roadperc_stream.batch.storage.location import Location
from roadperc_stream.batch.task import BatchConfiguration, BatchJob, Outcome
from roadperc_stream.config import load_config
from roadperc_stream.errors import StorageError
from tests.batch.backends import Scripted
from tests.batch.dataset import batch, statuses, write_log
from tests.batch.machines import wait_until
from tests.commands import words

ELSEWHERE = "host elsewhere, process 7, started 2026-01-01 00:00:00 UTC"


def holder(renewed_s):
    return LockHolder("elsewhere", 7, "2026-01-01 00:00:00 UTC", "another", renewed_s)


def lock_of_another(folder, renewed_s):
    folder.at(LOCK).write(msgspec.json.encode(holder(renewed_s)))


def read(folder):
    return msgspec.json.decode(folder.at(LOCK).read(), type=LockHolder)


@pytest.fixture(params=["s3", "fsspec"])
def store(request, monkeypatch):
    monkeypatch.setattr(dataset_lock, "_SETTLES_S", 0.0)
    address = request.getfixturevalue("bucket") if request.param == "s3" else f"memory://{time.monotonic_ns()}"
    return Location(f"{address}/out")


def test_a_second_batch_ends_with_an_error_that_names_the_first(tmp_path):
    out, folder = tmp_path / "out", tmp_path / "in"
    for number in range(2):
        write_log(folder / f"{number}.mcap", frames=10, lane_m=0.03 * number)
    with subprocess.Popen(words("roadperc-batch", out, folder, "--jobs", "1"), stdout=subprocess.DEVNULL) as first:
        wait_until(lambda: (out / LOCK).exists() or first.poll() is not None, 120)
        first.send_signal(signal.SIGSTOP)
        second = batch(out, folder)
        first.send_signal(signal.SIGCONT)
        who = f"host {socket.gethostname()}, process {first.pid}, started "
    assert (second.returncode, second.stdout, second.stderr.count("\n")) == (1, "", 1)
    assert second.stderr.startswith(f"error: {out}: another batch writes this dataset: {who}20")
    assert second.stderr.endswith("; wait until it ends\n")
    assert first.returncode == 0
    assert statuses(out) == {f"{number}.mcap": "done" for number in range(2)}
    assert not (out / LOCK).exists()


def test_a_plan_needs_no_lock(tmp_path):
    source, out = write_log(tmp_path / "a.mcap"), tmp_path / "out"
    with DatasetLock(Location(str(out))):
        assert batch(out, source, "--dry-run").stdout.startswith(f"replay  {source}: is new\n")


def test_in_a_store_the_second_batch_is_refused_until_the_first_ends(store):
    with DatasetLock(store):
        me = read(store)
        assert (me.host, me.process) == (socket.gethostname(), os.getpid())
        who = f"host {me.host}, process {me.process}, started {me.started}"
        why = f"{store.address}: another batch writes this dataset: {who}"
        with pytest.raises(StorageError, match=f"^{re.escape(why)}; wait until it ends, or 120 s after it was killed$"):
            DatasetLock(store).__enter__()
        assert read(store) == me
    assert store.at(LOCK).read() is None
    with DatasetLock(store):
        assert read(store).token != me.token


@pytest.mark.parametrize(("age_s", "is_free"), [(100, False), (-100, False), (121, True), (-121, True)])
def test_a_lock_in_a_store_is_dead_after_two_minutes(store, age_s, is_free):
    """A time in the future, of a wrong clock, counts in the same way."""
    lock_of_another(store, time.time() - age_s)
    with nullcontext() if is_free else pytest.raises(StorageError, match=ELSEWHERE), DatasetLock(store):
        assert read(store).process == os.getpid()


def test_a_file_without_a_lock_is_replaced(store):
    store.at(LOCK).write(b"rubbish")
    with DatasetLock(store):
        assert read(store).process == os.getpid()


def test_of_two_batches_at_the_same_moment_the_last_one_has_the_lock(store, monkeypatch):
    monkeypatch.setattr(dataset_lock.time, "sleep", lambda _: lock_of_another(store, time.time()))
    with pytest.raises(StorageError, match=ELSEWHERE):
        DatasetLock(store).__enter__()
    assert read(store).host == "elsewhere"


def test_a_lock_in_a_store_is_renewed_in_time(store, monkeypatch):
    assert 3 * dataset_lock.RENEW_EVERY_S < dataset_lock.DEAD_AFTER_S
    monkeypatch.setattr(dataset_lock, "RENEW_EVERY_S", 0.05)
    with DatasetLock(store) as lock:
        first = read(store)
        wait_until(lambda: read(store).renewed_s > first.renewed_s, 60)
        assert read(store).token == first.token
        lock.require_held()


def test_a_batch_that_lost_its_lock_ends_and_does_not_write_the_list(tmp_path, store, monkeypatch):
    """As after two minutes without the store."""
    source = write_log(tmp_path / "a.mcap")
    monkeypatch.setattr(dataset_lock, "RENEW_EVERY_S", 0.05)

    def taken(_task):
        lock_of_another(store, time.time())
        return Outcome("killed", "its process ended")

    job = BatchJob(BatchConfiguration(load_config(None)), store, retries=10**6)
    display = nullcontext(lambda _: None)
    with pytest.raises(StorageError, match=ELSEWHERE):
        BatchRun(job, [str(source)], None).run(lambda: Scripted(taken), lambda: display)
    assert read(store) == holder(read(store).renewed_s)
    assert store.at("runs.parquet").read() is None
