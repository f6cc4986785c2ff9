"""Fixtures every test may use, the environment all run in, and which tests run commands."""

import os
import re
import signal
from collections import Counter
from functools import cache
from pathlib import Path
from uuid import uuid4

import pytest
from hypothesis import settings

from tests.commands import SCRIPTS
from tests.object_store import environment_of, object_server

DEFAULT_DATA = Path(__file__).parents[2] / "shared" / "data"
STREAM_VARIABLES = (
    "PYTHONUNBUFFERED", "PYTHONIOENCODING", "PYTHONWARNINGS", "PYTHONDEVMODE", "FORCE_COLOR", "NO_COLOR",
    "TTY_COMPATIBLE", "TTY_INTERACTIVE",
)  # fmt: skip
"""What developers and CI services set, and what changes how a command prints: a fault must not hide behind it."""

for _name in STREAM_VARIABLES:
    os.environ.pop(_name, None)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in commands

# nohup ignores SIGHUP and a script's "&" SIGINT; all processes that tests start would ignore them too.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("roadperc", deadline=None, max_examples=50)  # a machine may be busy with other things
settings.load_profile("roadperc")


IMPORT = re.compile(r"^ *(?:from ([\w.]+) )?import (\([^)]*\)|.+)$", re.MULTILINE)


def pytest_collection_modifyitems(items):
    """Mark every module that starts a process or imports a command's main function, and sort modules.

    Those with few tests that take long come first. Otherwise one worker starts such a module last, and the others wait.
    """
    tests = Counter(item.path for item in items)
    first = {item.path for item in items if item.get_closest_marker("long") or item.path.name == "test_recorded.py"}

    def place(item):
        path = item.path
        return (0, tests[path], path) if path in first else (1, -tests[path], path)

    items.sort(key=place)
    for item in items:
        if _runs_commands(item.path):
            item.add_marker(pytest.mark.commands)


@cache
def _runs_commands(path):
    return not {"subprocess", "tests.commands", *_mains()}.isdisjoint(_imported(path))


def _imported(path):
    """Modules, and what is imported from them, by their full names; a syntax tree takes 25 times as long."""
    for module, names in IMPORT.findall(path.read_text("utf-8")):
        bare = {re.sub(r" as .*|#.*", "", name).strip(" ()\n") for name in names.split(",")}
        yield from {module, *(f"{module}.{name}" for name in bare)} if module else bare


def _mains():
    """The commands' modules, and their main functions."""
    for script in SCRIPTS.values():
        command = script.partition(":")[2]
        yield f"roadperc_stream.cli.{command}"
        yield f"roadperc_stream.cli.{command}.main"


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real recordings: $ROADPERC_DATA, by default ../shared/data beside the checkout."""
    path = Path(os.environ.get("ROADPERC_DATA", DEFAULT_DATA))
    if not (path / "course_frames").is_dir():
        pytest.skip(f"no recordings at {path}; set ROADPERC_DATA to their folder")
    return path


@pytest.fixture(scope="session")
def s3_server(tmp_path_factory):
    """An object store in a process of its own, started when the first test asks for it."""
    with object_server(tmp_path_factory.mktemp("s3")) as server:
        yield server


@pytest.fixture
def bucket(s3_server, monkeypatch):
    """The address of an empty bucket, and what reaches it in the environment."""
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    for name, value in environment_of(s3_server.url).items():
        monkeypatch.setenv(name, value)
    name = f"test-{uuid4().hex}"
    s3_server.send("PUT", name)
    return f"s3://{name}"
