"""Sending a log to Rerun's server without a window, which may close or block."""

import signal
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import monotonic, sleep

import pytest
import rerun_cli

from roadperc_stream.errors import RoadpercError, TargetError
from roadperc_stream.view.rerun import open_viewer, recording, viewer
from tests import logs


@pytest.fixture
def server(monkeypatch, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = free.getsockname()
    monkeypatch.setattr(viewer, "_ADDRESS", address)
    monkeypatch.setattr(recording, "URL", f"rerun+http://127.0.0.1:{address[1]}/proxy")
    binary = Path(rerun_cli.__file__).with_name("rerun")
    command = [binary, "--serve-grpc", "--bind", address[0], "--port", str(address[1])]
    with (tmp_path / "server.log").open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output)
    deadline = monotonic() + 60
    while not viewer._listening():
        assert monotonic() < deadline, (tmp_path / "server.log").read_text()
        sleep(0.1)
    yield process
    process.kill()
    process.wait()


def test_a_whole_log_is_sent(server, tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=3))
    assert open_viewer(source, {}).frames == 3
    assert server.poll() is None


def test_closing_the_viewer_is_an_error(server, tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=60))

    def close_window(frames, _expected):
        if frames == 10:
            server.kill()
            server.wait()

    with pytest.raises(TargetError, match=r"127\.0\.0\.1:\d+/proxy: the viewer was closed"):
        open_viewer(source, {}, close_window)


@pytest.mark.parametrize("answer", [b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n", b"hello\n", b""])
def test_another_program_on_the_port_is_an_error(monkeypatch, tmp_path, answer):
    monkeypatch.setattr(viewer, "_ANSWERS_WITHIN_S", 0.5)
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=1))
    with socket.create_server(("127.0.0.1", 0)) as other, ThreadPoolExecutor(1) as thread:
        monkeypatch.setattr(viewer, "_ADDRESS", other.getsockname())

        def serve():
            for _ in range(2):
                with other.accept()[0] as connection:
                    connection.send(answer)

        serving = thread.submit(serve)
        with pytest.raises(RoadpercError, match=r"127\.0\.0\.1:\d+: another program uses this port; close it, or"):
            open_viewer(source, {})
        serving.result()


SENDING = """
import signal, sys
from pathlib import Path
from roadperc_stream.view.rerun import open_viewer, recording, viewer

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it

def stopped(frames, expected):
    if frames == 1:
        print("stop", flush=True)
        sys.stdin.readline()

viewer._ADDRESS = ("127.0.0.1", int(sys.argv[2]))
recording.URL = f"rerun+http://127.0.0.1:{sys.argv[2]}/proxy"
open_viewer(Path(sys.argv[1]), {}, stopped)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM])
def test_a_signal_ends_the_wait_for_a_blocked_viewer(server, tmp_path, number):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=3))
    command = [sys.executable, "-c", SENDING, str(source), str(viewer._ADDRESS[1])]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as sender:
        assert sender.stdout.readline() == "stop\n"
        server.send_signal(signal.SIGSTOP)
        sender.stdin.write("\n")
        sender.stdin.close()
        with pytest.raises(subprocess.TimeoutExpired):  # it waits
            sender.wait(1)
        sender.send_signal(number)
        assert sender.wait(60) == -number
