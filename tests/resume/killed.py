"""A command in a process that is killed: ``N SECONDS COMMAND ARGUMENTS``.

It is killed before the N-th rename or removal, or after SECONDS of CPU time after the imports (0: never).
"""

import os
import shutil
import signal
import sys
from importlib import import_module
from itertools import count
from pathlib import Path


def main():
    last, after_s, calls = int(sys.argv[1]), float(sys.argv[2]), count(1)

    def before(function):
        def counted(*arguments, **options):
            if next(calls) == last:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **options)

        return counted

    for owner, name in ((Path, "replace"), (Path, "rename"), (Path, "unlink"), (shutil, "rmtree")):
        setattr(owner, name, before(getattr(owner, name)))
    signal.setitimer(signal.ITIMER_PROF, after_s)  # without a handler, the signal ends the process
    return import_module(f"roadperc_stream.cli.{sys.argv[3]}").main(sys.argv[4:])
