"""The process from which ``commands.run_forked`` forks: it has imported the package; a request is a line of JSON."""

import json
import os
import pkgutil
import re
import resource
import signal
import sys
from importlib import import_module
from pathlib import Path

import roadperc_stream
import roadperc_stream.eval
import roadperc_stream.tools
from roadperc_stream.cli import launch

TIMEOUT_S = 240


def import_all():
    """Import all modules that are installed; the benchmarks' are not."""
    for package in (roadperc_stream, roadperc_stream.eval, roadperc_stream.tools):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if ".bench" not in module.name:
                import_module(module.name)


def limit_memory(growth_bytes):
    """Limit writable memory, not address space: polars and Rerun reserve more than they use."""
    (kilobytes,) = re.findall(r"^VmData:\s+(\d+) kB$", Path("/proc/self/status").read_text("ascii"), re.MULTILINE)
    resource.setrlimit(resource.RLIMIT_DATA, (1024 * int(kilobytes) + growth_bytes, resource.RLIM_INFINITY))


def serve():
    import_all()
    while line := sys.stdin.readline():
        if not (child := os.fork()):
            _become(**json.loads(line))
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


def _become(command, arguments, cwd, folder, variables, memory_bytes, file_bytes):
    """Run a command in this process and end with its exit code."""
    signal.alarm(TIMEOUT_S)
    null = os.open(os.devnull, os.O_RDONLY)
    streams = [os.open(f"{folder}/{name}", os.O_WRONLY | os.O_CREAT | os.O_APPEND) for name in ("stdout", "stderr")]
    for number, stream in enumerate((null, *streams)):
        os.dup2(stream, number)
    modes = ("r", "w", "w")  # a command may replace its streams, and the files stay open
    sys.stdin, sys.stdout, sys.stderr = (os.fdopen(n, mode, closefd=False) for n, mode in enumerate(modes))
    os.environ.clear()
    os.environ.update(variables)
    os.chdir(cwd)
    if memory_bytes:
        limit_memory(memory_bytes)
    if file_bytes:
        resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
    sys.argv = [command, *arguments]
    code = 1
    try:
        code = _main(command)()
        sys.stdout.flush()
    finally:
        sys.stderr.flush()
        os._exit(code)


def _main(command):
    """The function of a console script, or the ``main`` of a module of the tests."""
    if command.startswith("tests."):
        return import_module(command).main
    return getattr(launch, command.replace("-", "_").removeprefix("roadperc_"))


if __name__ == "__main__":
    serve()
