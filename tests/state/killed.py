"""``roadperc-replay`` in a process that kills itself before the n-th change of a name: ``killed.py N ARGUMENTS``."""

import os
import shutil
import signal
import sys
from itertools import count
from pathlib import Path

from roadperc_stream.cli.replay import main

LAST, CALLS = int(sys.argv[1]), count(1)


def before(function):
    def counted(*arguments, **options):
        if next(CALLS) == LAST:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **options)

    return counted


Path.replace, Path.unlink, shutil.rmtree, os.fsync = map(before, (Path.replace, Path.unlink, shutil.rmtree, os.fsync))
sys.exit(main(sys.argv[2:]))
