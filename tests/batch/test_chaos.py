"""A batch over good and bad logs, whose workers are killed at random."""

import random
import subprocess
import time
from collections import Counter
from contextlib import suppress
from dataclasses import replace

import psutil
import pytest

from tests import logs
from tests.batch.dataset import assert_as_single, batch, runs, statuses, write_log
from tests.batch.machines import is_at_log, title
from tests.commands import words

pytestmark = pytest.mark.long

KILLS = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Good logs of several lengths, a cut log, an empty log, and a log that needs too much memory."""
    folder = tmp_path_factory.mktemp("logs")
    for number in range(5):
        write_log(folder / f"good_{number}.mcap", frames=10 + 5 * number, lane_m=0.04 * number)
    write_log(folder / "good_long.mcap", frames=80, lane_m=-0.04)
    whole = (folder / "good_4.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) // 3])
    (folder / "nothing.mcap").write_bytes(b"")
    logs.write(folder / "heavy.mcap", logs.items(1, road=replace(logs.SMALL, width=4480, height=3360)))
    return folder


def replaying(batch_process):
    """The processes of running logs: children of the server that forks them."""
    return [found for found in batch_process.children(recursive=True) if "forkserver" in title(parent_of(found))]


def watching(batch_process):
    """The processes of Ray that start them."""
    return [found for found in batch_process.children(recursive=True) if is_at_log(found)]


def parent_of(process):
    with suppress(psutil.NoSuchProcess):
        return process.parent() or process
    return process


@pytest.mark.parametrize(
    ("back_end", "kinds"),
    [
        (["--jobs", 2], [replaying]),
        pytest.param(["--jobs", 1], [replaying], marks=pytest.mark.accuracy),
        pytest.param(["--ray", "local", "--jobs", 2], [replaying, watching], marks=pytest.mark.accuracy),
    ],
)
def test_workers_killed_at_random(folder, tmp_path, back_end, kinds):
    out, rng, killed = tmp_path / "out", random.Random(str(back_end)), Counter()
    with subprocess.Popen(
        words("roadperc-batch", out, folder, *back_end, "--retries", "10", "--memory", "280MB"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        while process.poll() is None:
            time.sleep(rng.uniform(0.05, 0.3))
            kind = kinds[killed.total() % len(kinds)]
            workers = kind(psutil.Process(process.pid))
            if workers and killed.total() < KILLS:
                rng.choice(workers).kill()
                killed[kind] += 1
        printed, errors = process.communicate()
    assert process.returncode == 1, printed + errors
    assert "Traceback" not in printed + errors
    assert killed == dict.fromkeys(kinds, KILLS // len(kinds))
    good = {source.name: "done" for source in folder.glob("good_*.mcap")}
    assert statuses(out) == good | {"cut.mcap": "damaged", "nothing.mcap": "empty", "heavy.mcap": "memory"}
    assert runs(out)["attempts"].sum() > 9
    for source in sorted(folder.glob("good_*.mcap")):
        assert_as_single(out, source, tmp_path)


def test_a_log_whose_worker_always_dies_is_a_row_that_the_next_run_retries(tmp_path):
    out, source = tmp_path / "out", write_log(tmp_path / "in" / "deadly.mcap", frames=40)
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
