"""A batch whose workers are killed at random, over logs of which some cannot be replayed."""

import random
import subprocess
import time
from dataclasses import replace

import psutil
import pytest

from tests import logs
from tests.batch.dataset import assert_as_single, batch, runs, statuses, write_log
from tests.commands import words

KILLS = 6


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Eight good logs of several lengths, one cut short, one empty, one that needs more memory than it may."""
    folder = tmp_path_factory.mktemp("drives")
    for number in range(8):
        write_log(folder / f"good_{number}.mcap", frames=10 + 5 * number, lane_m=0.04 * number)
    whole = (folder / "good_7.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) // 3])
    (folder / "nothing.mcap").write_bytes(b"")
    logs.write(folder / "huge.mcap", logs.items(6, road=replace(logs.SMALL, width=5600, height=4200)))
    return folder


def replaying(process):
    """The processes of a batch in which logs are at work: those that were forked from the one that imported it all."""
    try:
        servers = [p for p in process.children() if "forkserver" in " ".join(p.cmdline())]
        return [child for server in servers for child in server.children()]
    except psutil.Error:
        return []


@pytest.mark.parametrize("jobs", [1, 2])
def test_workers_killed_at_random(drives, tmp_path, jobs):
    out, rng, killed = tmp_path / "out", random.Random(jobs), 0
    with subprocess.Popen(
        words("roadperc-batch", out, drives, "--jobs", jobs, "--retries", "10", "--memory", "280MB"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        while process.poll() is None:
            time.sleep(rng.uniform(0.1, 0.6))
            workers = replaying(psutil.Process(process.pid))
            if workers and killed < KILLS:
                rng.choice(workers).kill()
                killed += 1
        printed, errors = process.communicate()
    assert process.returncode == 1, printed + errors
    assert "Traceback" not in printed + errors
    assert killed == KILLS
    good = {f"good_{number}.mcap": "done" for number in range(8)}
    assert statuses(out) == good | {"cut.mcap": "damaged", "nothing.mcap": "empty", "huge.mcap": "memory"}
    assert runs(out)["attempts"].sum() > 10
    for source in sorted(drives.glob("good_*.mcap")):
        assert_as_single(out, source, tmp_path)


def test_a_log_that_kills_its_worker_each_time_is_a_row_that_the_next_run_tries_again(tmp_path):
    out, source = tmp_path / "out", write_log(tmp_path / "in" / "deadly.mcap", frames=300)
    with subprocess.Popen(
        words("roadperc-batch", out, source, "--retries", "1"), stdout=subprocess.PIPE, text=True
    ) as process:
        while process.poll() is None:
            time.sleep(0.02)
            for worker in replaying(psutil.Process(process.pid)):
                worker.kill()
    assert process.returncode == 1
    (row,) = runs(out).to_dicts()
    assert (row["status"], row["attempts"], row["error"]) == ("killed", 2, "its process ended by SIGKILL")
    assert batch(out, source).returncode == 0
    assert_as_single(out, source, tmp_path)
