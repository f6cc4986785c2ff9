"""A real object store on this machine: moto's S3 server in its own process, and a proxy that breaks connections."""

import contextlib
import os
import socket
import subprocess
import sys
import threading
import urllib.request
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

SERVER = """
import sys
from moto.server import ThreadedMotoServer
server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
server.start()
print(server.get_host_and_port()[1], flush=True)
sys.stdin.read()
"""
"""Ends with the process that started it."""


@dataclass(frozen=True)
class ObjectServer:
    """An S3 server that accepts any credentials, except within ``checking_credentials``."""

    port: int
    log: Path

    @property
    def url(self):
        return f"http://127.0.0.1:{self.port}"

    def send(self, method, path, data=None):
        """Send an unsigned request."""
        kind = {"Content-Type": "application/octet-stream"}
        request = urllib.request.Request(f"{self.url}/{quote(path)}", data=data, method=method, headers=kind)
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.read()

    @contextmanager
    def checking_credentials(self):
        """Refuse unknown keys within the block."""
        self.send("POST", "moto-api/reset-auth", b"0")
        try:
            yield
        finally:
            self.send("POST", "moto-api/reset-auth", b"inf")

    def requests(self):
        """All requests, in order, such as ``GET /bucket?list-type=2``."""
        return [line.split('"')[1].rpartition(" ")[0] for line in self.log.read_text().splitlines() if '"' in line]


@contextmanager
def object_server(folder):
    """An empty server, with its log in a folder."""
    log = folder / "requests.log"
    environment = {name: value for name, value in os.environ.items() if not name.startswith("AWS_")}
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-c", SERVER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stream,
            env={**environment, "PYTHONWARNINGS": "ignore"},
        )
    with process:
        yield ObjectServer(int(process.stdout.readline()), log)
        process.stdin.close()


def environment_of(url):
    """The environment variables for a server."""
    return {
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "AWS_ENDPOINT_URL": url,
        "AWS_EC2_METADATA_DISABLED": "true",
    }


@dataclass
class BreakingProxy:
    """A proxy of a server that breaks connections.

    Attributes:
        target: port of the server.
        after_bytes: a connection breaks after this many bytes in either direction.
        breaks: number of connections that still break.
    """

    target: int
    after_bytes: int
    breaks: int
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __enter__(self):
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listening.getsockname()[1]}"
        self._accepting = threading.Thread(target=self._accept)
        self._accepting.start()
        return self

    def __exit__(self, *raised):
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self._accepting.join()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                client = self._listening.accept()[0]
                server = socket.create_connection(("127.0.0.1", self.target))
                for ends in ((client, server), (server, client)):
                    threading.Thread(target=self._pass, args=ends, daemon=True).start()

    def _pass(self, source, target):
        passed = 0
        with contextlib.suppress(OSError):
            while data := source.recv(1 << 16):
                passed += len(data)
                if passed > self.after_bytes and self._breaks_now():
                    break
                target.sendall(data)
        for end in (source, target):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    def _breaks_now(self):
        with self._lock:
            breaks_now = self.breaks > 0
            self.breaks -= breaks_now
            return breaks_now
