"""Freed memory is kept for the next arrays, where the C library can."""

import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource
import sys
import numpy as np
from roadperc_stream.system.process import keep_freed_memory

if sys.argv[1] == "keep":
    keep_freed_memory()

def frame():
    kept = [np.ones(4 << 17) for _ in range(8)]
    return sum(array[0] for array in kept)

for _ in range(3):
    frame()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(4):
    frame()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(mode):
    return int(subprocess.run([sys.executable, "-c", FAULTS, mode], check=True, capture_output=True, text=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="a setting of glibc's")
def test_kept_memory_is_not_asked_for_again():
    assert faults("keep") < 100 < faults("as usual")
