"""How much memory a process takes, and how much more it may take."""

import re
import resource
from pathlib import Path

import cv2

MOST_GROWTH_BYTES = 2**30
_STATUS = Path("/proc/self/status")
_FIELDS = re.compile(r"^(VmSize|VmRSS|VmHWM):\s+(\d+) kB$", re.MULTILINE)


def memory() -> dict[str, int]:
    """Bytes of address space (VmSize), in memory (VmRSS), and the most that were in memory (VmHWM)."""
    return {name: 1024 * int(kilobytes) for name, kilobytes in _FIELDS.findall(_STATUS.read_text("ascii"))}


def limit_growth() -> int:
    """Let the address space of this process grow by a gigabyte and no more; gives the limit."""
    most = memory()["VmSize"] + MOST_GROWTH_BYTES
    limit_to(most)
    return most


def limit_to(most_bytes: int) -> None:
    """Let this process have so much address space."""
    resource.setrlimit(resource.RLIMIT_AS, (most_bytes, resource.getrlimit(resource.RLIMIT_AS)[1]))


def limit_process(most_bytes: int, most_s: int) -> None:
    """Let this process have so much address space, and so many seconds of the processor."""
    limit_to(most_bytes)
    resource.setrlimit(resource.RLIMIT_CPU, (most_s, most_s))


def lift_limit() -> None:
    """Let it have what the machine has, for work between the cases."""
    limit_to(resource.getrlimit(resource.RLIMIT_AS)[1])


def forget_peak() -> None:
    """Let VmHWM begin anew."""
    Path("/proc/self/clear_refs").write_text("5", "ascii")


_refused: list[str] = []


def watch_opencv() -> None:
    """Note what memory OpenCV asks for in vain: its callers take such an image for one that cannot be read."""
    _refused.clear()
    cv2.redirectError(_note)


def _note(status: int, _function: str, message: str, *_: object) -> int:
    if status == cv2.Error.StsNoMem:
        _refused.append(message)
    return 0


def refused() -> list[str]:
    """The faults since then."""
    return [f"memory: OpenCV: {_refused[0]}"] if _refused else []
