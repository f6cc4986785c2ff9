"""What a program takes: it runs as a child of a small one, which the system tells its time and memory."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from roadperc_stream.errors import ProgramError

_STARTER: Final = """
import json, os, sys, time
null = os.open(os.devnull, os.O_RDWR)
actions = [(os.POSIX_SPAWN_DUP2, null, 0), (os.POSIX_SPAWN_DUP2, null, 1)]
started = time.perf_counter()
child = os.posix_spawnp(sys.argv[1], sys.argv[1:], os.environ, file_actions=actions)
_, status, used = os.wait4(child, 0)
wall_s = time.perf_counter() - started
print(json.dumps((os.waitstatus_to_exitcode(status), wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss)))
"""
"""A process's largest memory begins with that of the one that started it, which here is next to nothing."""
_KIB: Final = 1 if sys.platform == "darwin" else 1024


@dataclass(frozen=True)
class Cost:
    """Seconds on the clock, seconds of all cores together, most memory at once."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def cost_of(name: str, command: Sequence[str]) -> Cost:
    """Run a program to its end, its stdout dropped; who interrupts this ends it, too.

    Args:
        name: what an error calls it.
        command: the program and its arguments.

    Raises:
        ProgramError: it fails.
    """
    words = [sys.executable, "-I", "-S", "-c", _STARTER, *command]
    with subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, process_group=0) as starter:
        try:
            said, _ = starter.communicate()
        except BaseException:
            os.killpg(starter.pid, signal.SIGTERM)
            raise
    if starter.returncode:
        raise ProgramError(f"{name} could not be started")
    code, wall_s, cpu_s, peak = json.loads(said)
    if code:
        raise ProgramError(f"{name} ended with exit code {code}")
    return Cost(wall_s, cpu_s, peak * _KIB / 1e6)
