"""Batches on a local Ray, and on a real Ray cluster of two machines, one of which fails.

``make cluster`` runs all tests; `make test-long` runs a batch on a local Ray.
"""

import os
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import psutil
import pytest

from roadperc_stream.batch import cluster
from roadperc_stream.batch.cluster import RayBackend
from roadperc_stream.errors import ClusterError
from tests.batch.dataset import assert_as_single, batch, runs, statuses, write_log
from tests.batch.machines import free_port, is_at_log, kill, machines, title, wait_until
from tests.commands import words

LOGS = 6
INTERRUPTED = "interrupted; run the same command again to continue"


@pytest.fixture(scope="module")
def two_machines():
    with machines() as found, pytest.MonkeyPatch.context() as patch:
        for name, value in found.variables.items():
            patch.setenv(name, value)
        found.second = found.add()
        yield found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for number in range(LOGS):
        write_log(folder / f"log_{number}.mcap", frames=20 + number, lane_m=0.05 * number)
    return folder


def started_batch(*arguments):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(words("roadperc-batch", *arguments), **pipes)


@pytest.mark.accuracy  # of its own target: on a busy machine Ray's client may not find its server in time
def test_a_batch_from_outside_by_ray_client(two_machines, tmp_path):
    """A task that asks for more memory than any machine has gets the largest for itself."""
    source = write_log(tmp_path / "log.mcap")
    address = two_machines.client_address
    done = batch(tmp_path / "out", source, "--ray", address, "--memory", "900TB", env=os.environ)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    assert_as_single(tmp_path / "out", source, tmp_path)


@pytest.mark.accuracy
def test_a_lost_machine_loses_no_log(two_machines, folder, tmp_path):
    out = tmp_path / "out"
    with started_batch(out, folder, "--ray", two_machines.address, "--memory", "500MB") as process:
        wait_until(lambda: two_machines.held(two_machines.second) or process.poll() is not None, 180)
        kill(two_machines.second)
        printed, errors = process.communicate(timeout=240)
    assert (process.returncode, errors) == (0, ""), printed
    assert printed.splitlines()[0].startswith(f"{LOGS} logs done: ")
    assert set(statuses(out).values()) == {"done"}
    assert runs(out)["attempts"].max() == 2, "no log was running on the lost machine"
    for source in sorted(folder.glob("*.mcap")):
        assert_as_single(out, source, tmp_path)


@pytest.mark.accuracy
def test_a_lost_cluster_ends_the_batch(two_machines, folder, tmp_path, monkeypatch):
    """The last test of this cluster; by default Ray waits a minute for the head to come back."""
    monkeypatch.setenv("RAY_gcs_rpc_server_reconnect_timeout_s", "3")
    head = psutil.Process(two_machines.started[0].pid)
    with started_batch(tmp_path / "out", folder, "--ray", two_machines.address) as process:
        wait_until(lambda: two_machines.held(head) or process.poll() is not None, 180)
        kill(head)
        process.communicate(timeout=120)
    assert process.returncode
    assert batch(tmp_path / "out", folder).returncode == 0


@pytest.mark.long
@pytest.mark.parametrize("sent", [
    None, *(pytest.param(sent, marks=pytest.mark.accuracy) for sent in (signal.SIGINT, signal.SIGKILL))
])  # fmt: skip
def test_a_local_ray_gives_the_rows_of_single_replays_and_ends_with_the_batch(folder, tmp_path, sent):
    family = []
    with started_batch(tmp_path / "out", folder, "--ray", "local", "--jobs", "1") as process:

        def is_at_work():
            family[:] = psutil.Process(process.pid).children(recursive=True)
            return any(is_at_log(p) for p in family) or process.poll() is not None

        wait_until(is_at_work, 180)
        if sent:
            process.send_signal(sent)
        _, errors = process.communicate(timeout=240)
    codes = {None: 0, signal.SIGINT: 1, signal.SIGKILL: -signal.SIGKILL}
    printed = f"error: {INTERRUPTED}\n" if sent == signal.SIGINT else ""
    assert (process.returncode, errors) == (codes[sent], printed)
    _, left = psutil.wait_procs(family, timeout=90)
    assert [title(p) for p in left] == []
    for source in () if sent else sorted(folder.glob("*.mcap")):
        assert_as_single(tmp_path / "out", source, tmp_path)


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("nonsense", "expected local, auto, HOST:PORT or ray://HOST:PORT"),
        ("http://127.0.0.1:80", "expected local, auto, HOST:PORT or ray://HOST:PORT"),
        ("127.0.0.1:port", "expected local, auto, HOST:PORT or ray://HOST:PORT"),
        ("ray://", "expected local, auto, HOST:PORT or ray://HOST:PORT"),
        ("no-such-host.invalid:6379", "no cluster at this address: "),
    ],
)
def test_an_invalid_address(address, why):
    with pytest.raises(ClusterError, match=rf"--ray {address}: {why}"), RayBackend(address, 1, 1):
        pass


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_an_address_without_a_listener(scheme):
    address = f"{scheme}127.0.0.1:{free_port()}"
    with (
        pytest.raises(ClusterError, match=f"--ray {address}: no cluster at this address: .*refused"),
        RayBackend(address, 1, 1),
    ):
        pass


def test_a_cluster_may_answer_in_pieces():
    def answer(server):
        with server.accept()[0] as connection:
            connection.recv(len(cluster._GREETING))
            for piece in (bytes(2), bytes(1), cluster._SETTINGS):
                connection.sendall(piece)
                time.sleep(0.05)

    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as thread:
        answered = thread.submit(answer, server)
        cluster._require_listener(f"127.0.0.1:{server.getsockname()[1]}")
        answered.result()


@pytest.mark.parametrize("scheme", ["", "ray://"])
@pytest.mark.parametrize(("answer", "why"), [(b"", "timed out"), (b"HTTP/1.1 400", "another program listens there")])
def test_an_address_with_another_listener(monkeypatch, scheme, answer, why):
    """Ray itself tries for minutes to join such a server."""
    monkeypatch.setattr(cluster, "_ANSWER_WITHIN_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as thread:
        address = f"{scheme}127.0.0.1:{server.getsockname()[1]}"
        accepted = thread.submit(server.accept)
        answered = thread.submit(lambda: accepted.result()[0].sendall(answer))
        with pytest.raises(ClusterError, match=f"^--ray {address}: .*{why}$"), RayBackend(address, 1, 1):
            pass
        answered.result()
        accepted.result()[0].close()


def test_without_ray_the_error_has_the_command_to_install_it(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "roadperc_stream.batch.cluster")
    done = batch(tmp_path / "out", folder, "--ray", "local")
    install = "pip install '.[cluster]' in the project's folder"
    assert (done.returncode, done.stderr) == (1, f"error: --ray: Ray is not installed; {install}\n")
