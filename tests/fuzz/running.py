"""Runs a command on wrong input, and requires that it ends as promised."""

import os
import re
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import settings

from tests.commands import run_forked

EXAMPLES = os.environ.get("FUZZ", "")
examples = settings(max_examples=int(EXAMPLES or 10), derandomize=not EXAMPLES, deadline=None)
"""Few examples, equal in every run; ``make fuzz`` draws more."""
GROWTH_BYTES = 3 * 2**29
"""New memory of a command, at most."""
ASIDE = re.compile(
    r"(note|warning): |libpng |\[ WARN|Corrupt JPEG|Premature end of JPEG|Unsupported marker|Invalid SOS"
)
"""Notes, and what OpenCV and its decoders print."""
WRITES_FAILURES = ("batch", "check", "compare")
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029]")


@contextmanager
def folder_of(files):
    """A folder with these files, by name."""
    with TemporaryDirectory(prefix="fuzz-") as name:
        for path, data in files.items():
            Path(name, path).parent.mkdir(parents=True, exist_ok=True)
            Path(name, path).write_bytes(data)
        yield Path(name)


def require_clear_end(folder, *words):
    """Run a command, and require a result or one error line; returns its exit code."""
    before = _files(folder)
    done = run_forked(f"roadperc-{words[0]}", *words[1:], cwd=folder, memory_bytes=GROWTH_BYTES)
    said = [line for line in done.stderr.split("\n") if line.strip() and not ASIDE.match(line)]
    if done.returncode == 2:
        assert re.match(rf"roadperc-{words[0]}: error: ", said[-1]), done.stderr
    else:
        assert len(said) == (done.returncode != 0), (words, done.returncode, done.stderr)
    assert done.returncode in (0, 1, 2, 3), (words, done.returncode, done.stderr)
    assert not CONTROL.search(done.stdout + done.stderr), (words, done.stdout, done.stderr)
    _require_whole_files(folder, words[0], done.returncode, _files(folder) - before)
    return done.returncode


def _require_whole_files(folder, command, code, made):
    """A command that fails leaves no file, except where the failure is its result."""
    assert not [name for name in made if ".partial" in name]
    if code == 0:
        for name in made:
            if name.endswith(".mcap"):
                assert run_forked("roadperc-info", name, cwd=folder).returncode == 0, name
    elif command not in WRITES_FAILURES:
        assert not made, (command, made)


def _files(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}
