"""``roadperc-replay`` in a process that is killed: ``killed.py N SECONDS ARGUMENTS``.

It is killed before the N-th rename, removal or sync, or after SECONDS of CPU time after the imports (0: never).
"""

import os
import shutil
import signal
import sys
from itertools import count
from pathlib import Path

from roadperc_stream.cli.replay import main

LAST, AFTER_S, CALLS = int(sys.argv[1]), float(sys.argv[2]), count(1)


def before(function):
    def counted(*arguments, **options):
        if next(CALLS) == LAST:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **options)

    return counted


Path.replace, Path.unlink, shutil.rmtree, os.fsync = map(before, (Path.replace, Path.unlink, shutil.rmtree, os.fsync))
signal.setitimer(signal.ITIMER_PROF, AFTER_S)  # without a handler, the signal ends the process
sys.exit(main(sys.argv[3:]))
