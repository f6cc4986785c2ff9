import os
import signal
import subprocess
import time

import pytest

from tests.mutants import forks


def test_each_job_is_done_in_a_process_and_a_folder_of_its_own():
    def work(job, folder):
        (folder / "who").write_text(f"{job} {os.getpid()}")
        print("said", job)
        return job

    found, folders = [], []
    for ended in forks.run([3, 4, 5], work, lambda _: 60.0, 2):
        job, pid = (ended.folder / "who").read_text().split()
        assert (ended.code, ended.hung) == (int(job), False)
        assert int(pid) != os.getpid()
        assert (ended.folder / forks.OUTPUT).read_text() == f"said {job}\n"
        found.append(ended.job)
        folders.append(ended.folder)
    assert sorted(found) == [3, 4, 5]
    assert not any(folder.exists() for folder in folders)


def test_what_gives_no_sign_of_life_has_hung():
    (ended,) = forks.run(["job"], lambda *_: time.sleep(60) or 0, lambda _: 0.2, 1)
    assert (ended.hung, ended.code) == (True, -signal.SIGKILL)


def test_signs_of_life_are_waited_for():
    def work(job, folder):
        for _ in range(10):
            time.sleep(0.1)
            os.utime(folder / forks.BEAT)
        return 0

    (ended,) = forks.run(["job"], work, lambda _: 0.9, 1)
    assert not ended.hung


def test_an_exception_is_told_by_code_and_output():
    runs = forks.run(["job"], lambda *_: 1 // 0, lambda _: 60.0, 1)
    ended = next(runs)
    assert ended.code == 70
    assert "ZeroDivisionError" in (ended.folder / forks.OUTPUT).read_text()
    runs.close()


def test_stopping_early_leaves_no_process_behind(tmp_path):
    def work(job, folder):
        if job == 0:
            return 0
        sleeper = subprocess.Popen(["sleep", "60"])
        (tmp_path / "pid").write_text(str(sleeper.pid))
        sleeper.wait()
        return 0

    runs = forks.run([1, 0], work, lambda _: 60.0, 2)
    next(runs)
    while not (tmp_path / "pid").is_file():
        time.sleep(0.01)
    time.sleep(0.05)
    runs.close()
    pid = int((tmp_path / "pid").read_text())
    for _ in range(100):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        if b"Z" in subprocess.run(["ps", "-o", "stat=", str(pid)], capture_output=True, check=False).stdout:
            return
        time.sleep(0.05)
    pytest.fail("the process that the job started still runs")
