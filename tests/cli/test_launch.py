"""The start and end of every command: signals during imports, closed streams, full devices, limits, odd names."""

import os
import re
import resource
import signal
import subprocess
import sys
import time
from importlib import import_module
from itertools import product
from pathlib import Path

import pytest

from roadperc_stream import api
from roadperc_stream.cli import render, replay
from roadperc_stream.cli.launch import COMMANDS
from roadperc_stream.errors import TargetError
from tests.commands import BUFFERINGS, environment, run, run_forked, status, words
from tests.test_sample import SAMPLE

ROOT = Path(__file__).parents[2]
ODD = os.fsdecode(b"bad\xff.mcap")
FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this system")


def signalling(folder, library, number):
    """A slow library that swallows exceptions during its import, in front of the real one."""
    folder.joinpath(f"{library}.py").write_text(
        f"import os, time\ntry:\n    os.kill(os.getpid(), {int(number)})\n    time.sleep(20)\n"
        "except BaseException:\n    pass\nraise SystemExit('went on')\n"
    )
    return environment(PYTHONPATH=str(folder))


ENOUGH = {
    "roadperc-bisect": ["in.mcap", "--criteria", "limits.toml"],
    "roadperc-infer": ["in.mcap", "out.mcap", "--network", "n.toml"],
    "roadperc": ["info", "in.mcap"],
    "roadperc-degrade": ["in.mcap", "out.mcap", "--with", "fog=1"],
    "roadperc-lanes": ["in.mcap", "--tusimple", "lanes.json"],
    "roadperc-render": ["drive"],
    "roadperc-sweep": ["in.mcap", "--vary", "seed=1,2"],
    "roadperc-view": ["in.mcap"],
}
"""Valid arguments of commands that do not take two names."""
ERRORS = {"roadperc-bisect": 3, "roadperc-check": 3, "roadperc-compare": 3}
"""Exit codes of errors, if not 1."""
ONE_OF_A_KIND = (
    "roadperc",
    "roadperc-batch",
    "roadperc-bisect",
    "roadperc-compare",
    "roadperc-info",
    "roadperc-render",
    "roadperc-replay",
    "roadperc-sweep",
    "roadperc-view",
)
"""All commands start in the same function. These differ in the libraries, the processes or the exit codes."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.mark.parametrize(
    ("command", "library", "number"),
    [
        # argparse is imported before the arguments are read; rich, or in a replay cv2, before the work
        *((command, "rich", signal.SIGINT) for command in ONE_OF_A_KIND if command != "roadperc-replay"),
        *product(["roadperc-replay"], ["argparse", "numpy", "cv2", "pyarrow"], [signal.SIGINT]),
        *product(["roadperc-replay"], ["cv2"], SIGNALS[1:]),
    ],
)
def test_a_signal_during_an_import_is_one_line(tmp_path, command, library, number):
    arguments = ENOUGH.get(command, ["in.mcap", "out.mcap"])
    ended = run(command, *arguments, env=signalling(tmp_path, library, number), cwd=tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (ERRORS.get(command, 1), "", "error: interrupted\n")


FATAL = {
    "interpreter": ("import ctypes; ctypes.pythonapi.Py_FatalError(b'no state')", signal.SIGABRT, "error: no state\n"),
    "library": ("import ctypes; ctypes.CDLL(None).abort()", signal.SIGABRT, "error: Aborted\n"),
    "memory": ("import faulthandler; faulthandler._sigsegv()", signal.SIGSEGV, "error: Segmentation fault\n"),
}
"""Code that ends a process, the signal, and the error."""


def dying(folder, code, python=()):
    """Run a command that crashes in its first import, after a library has written to file 2."""
    folder.joinpath("argparse.py").write_text(f"import os\nos.write(2, b'free(): \\x1b[31m pointer\\n')\n{code}\n")
    command, *words_after = words("roadperc-info", "in.mcap")
    env = environment(PYTHONPATH=str(folder))
    return subprocess.run([command, *python, *words_after], check=False, capture_output=True, text=True, env=env)


@pytest.mark.promise("Crashes", 'A crash prints "Fatal Python error", each thread\'s stack and what the library wrote')
@pytest.mark.parametrize("python", [(), ("-X", "faulthandler")], ids=["plain", "faulthandler"])
@pytest.mark.parametrize("kind", FATAL)
def test_a_crash_is_shown_with_the_output_of_the_library(tmp_path, kind, python):
    pytest.importorskip("roadperc_stream.system.fatal_output")
    code, number, error = FATAL[kind]
    ended = dying(tmp_path, code, python)
    assert ended.returncode == -number
    assert ended.stderr.count(f"Fatal Python {error}") == 1
    assert f'{tmp_path / "argparse.py"}", line 3 in <module>' in ended.stderr
    assert ended.stderr.count("free(): ?[31m pointer\n") == (number == signal.SIGABRT)  # others have no reason


@pytest.mark.promise("Crashes", "A crash after the interpreter has ended is shown")
def test_a_crash_after_the_interpreter_has_ended_is_shown(tmp_path):
    pytest.importorskip("roadperc_stream.system.fatal_output")
    code = "import ctypes\nlibc = ctypes.CDLL(None)\nlibc['__cxa_atexit'](libc.abort, None, None)\nraise SystemExit(3)"
    ended = dying(tmp_path, code)
    assert (ended.returncode, ended.stderr) == (-signal.SIGABRT, "free(): ?[31m pointer\n")


@pytest.mark.promise("Crashes", "At most 1 MiB of what libraries write to stderr is kept, in memory")
def test_the_output_of_libraries_has_a_limit_and_a_crash_is_shown_beyond_it(tmp_path):
    ended = dying(tmp_path, f"os.write(2, b'x' * {1 << 21})\nimport ctypes; ctypes.CDLL(None).abort()")
    assert ended.returncode == -signal.SIGABRT
    assert "Fatal Python error: Aborted\n" in ended.stderr
    assert len(ended.stderr) < 20_000


@pytest.mark.promise("Crashes", "A command that does not crash prints no crash report")
def test_a_command_without_a_crash_prints_no_crash_report(tmp_path):
    ended = dying(tmp_path, "raise SystemExit(3)")
    assert (ended.returncode, ended.stderr) == (3, "")


def test_a_signal_that_nohup_ignores_ends_nothing():
    code = (
        "import os, signal; signal.signal(signal.SIGHUP, signal.SIG_IGN); from roadperc_stream.cli.plumbing import run;"
    )
    code += "print(run(lambda: os.kill(os.getpid(), signal.SIGHUP)))"
    ended = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "0\n", "")


def test_the_start_of_a_command_imports_no_library():
    code = "import sys, roadperc_stream.cli.launch; print(*{name.partition('.')[0] for name in sys.modules})"
    bare = [sys.executable, "-S", "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r}); {code}"]
    loaded = subprocess.run(bare, check=True, capture_output=True, text=True).stdout.split()
    assert set(loaded) - {"roadperc_stream", "__main__"} <= sys.stdlib_module_names
    assert not {"typing", "pathlib", "email", "argparse"} & set(loaded)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two short runs with other settings, and a dump."""
    folder = tmp_path_factory.mktemp("made")
    for main, *arguments in (
        (replay.main, SAMPLE, folder / "run.mcap", "--frames", "3"),
        (replay.main, SAMPLE, folder / "other.mcap", "--frames", "3", "--set", "surface.inlier_m=0.5"),
        (render.main, folder / "dump", "--size", "160x120", "--seconds", "0.1"),
    ):
        assert main([str(argument) for argument in arguments]) == 0
    return folder


WRITING = [
    ("roadperc-replay", [SAMPLE, "OUT/file.mcap", "--frames", "2"]),
    ("roadperc-convert", ["MADE/dump", "OUT/file.mcap"]),
    ("roadperc-compare", ["OUT/file", "MADE/run.metrics.parquet", "--update-reference"]),
    ("roadperc-report", ["MADE/run.mcap", "--html", "OUT/file.html"]),
    ("roadperc-lanes", ["MADE/run.mcap", "--tusimple", "OUT/file.json"]),
    ("roadperc-view", ["MADE/run.mcap", "--foxglove-layout", "OUT/file.json"]),
]


JUDGES = {"roadperc-bisect", "roadperc-check", "roadperc-compare"}
"""Commands whose exit code 1 is a result; an error exits with 3."""
CODES = {"--help": 0, "--version": 0, "--wrong": 2, "none.mcap": 1}
"""Exit codes of the arguments."""
UNREAD = [("closed", "buffered"), *(("unread", buffering) for buffering in BUFFERINGS)]


@pytest.mark.parametrize(("command", "arguments"), WRITING, ids=[command for command, _ in WRITING])
def test_the_work_is_done_without_a_reader(command, arguments, made, tmp_path):
    state = "closed" if command in {"roadperc-replay", "roadperc-report", "roadperc-view"} else "unread"
    given = [re.sub("^MADE", str(made), re.sub("^OUT", str(tmp_path), str(argument))) for argument in arguments]
    assert status(words(command, *given), state) == 0
    assert [path.name for path in tmp_path.glob("file*")]


@pytest.mark.parametrize(("state", "buffering"), UNREAD)
@pytest.mark.parametrize(("argument", "code"), CODES.items())
def test_the_exit_code_without_a_reader(argument, code, state, buffering):
    assert status(words("roadperc-info", argument), state, buffering) == code


def test_a_comparison_has_its_exit_code_without_a_reader(made):
    assert status(words("roadperc-compare", made / "run.mcap", made / "other.mcap", "--exact"), "unread") == 1


@pytest.mark.promise("Start and end", "Output to a full device gives one error line")
@pytest.mark.promise("Start and end", "With stderr on a full device the exit code is the documented one")
@pytest.mark.promise("Start and end", "With stdout and stderr on a full device the exit code is the documented one")
@needs_full
@pytest.mark.parametrize(
    ("command", "arguments", "full", "buffering", "code"),
    [
        *product(["roadperc-info"], [["--version"], ["--help"], [SAMPLE]], ["stdout"], BUFFERINGS, [1]),
        ("roadperc-batch", ["--help"], "stderr", "buffered", 0),
        ("roadperc-batch", ["--wrong"], "stderr", "buffered", 2),
        *(
            (command, ENOUGH.get(command, ["in.mcap", "out.mcap"]), "stderr", "buffered", ERRORS.get(command, 1))
            for command in ONE_OF_A_KIND
        ),
        *(("roadperc-info", [word], "stderr", "unbuffered", code) for word, code in CODES.items()),
        *(("roadperc-info", [word], "both", "buffered", code or 1) for word, code in CODES.items()),
    ],
)
def test_a_full_device_leaves_the_exit_code(command, arguments, full, buffering, code, tmp_path):
    """A full stdout is an error, printed if stderr is not full."""
    if (command, code) == ("roadperc-render", 1):
        arguments = ["/proc/dump"]
    with FULL.open("w") as device:
        streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "capture_output": False}
        streams |= dict.fromkeys(("stdout", "stderr") if full == "both" else (full,), device)
        ended = run(command, *arguments, env=environment(buffering), cwd=tmp_path, **streams)
    assert ended.returncode == code
    if full == "stdout":
        assert ended.stderr == "error: No space left on device\n"


@pytest.mark.promise("Start and end", "File names after `--` may begin with `-`")
def test_names_after_two_dashes_may_begin_with_a_dash(made, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("-run.mcap", "-run.metrics.parquet", "--run.mcap"):
        (tmp_path / name).write_bytes((made / name.lstrip("-")).read_bytes())
    with (made / "run.mcap").open() as piped:
        ended = run("roadperc-replay", "-", "--frames", "1", "--", "-piped.mcap", cwd=tmp_path, stdin=piped)
    assert ended.returncode == 0, ended.stderr
    for command, *arguments in (
        ("replay", "--frames", "1", "--", "-run.mcap", "-out.mcap"),
        ("info", "--", "-run.mcap", "--run.mcap"),
        ("report", "--", "-run.mcap"),
        ("trajectory", "--", "-run.mcap"),
        ("compare", str(made / "run.mcap"), "--", "-run.mcap"),
        ("lanes", "--tusimple", "lanes.json", "--", "-run.mcap"),
        ("view", "--save", "run.rrd", "--", "-run.mcap"),
        ("render", "--size", "160x120", "--seconds", "0.1", "--", "-dump"),
        ("convert", "--", "-dump", "-dump.mcap"),
        ("sweep", "--vary", "seed=1,2", "--frames", "1", "--jobs", "1", "--", "-run.mcap"),
        ("batch", "--jobs", "1", "--frames", "1", "--", "-dataset", "-run.mcap"),
    ):
        assert import_module(f"roadperc_stream.cli.{command}").main(arguments) == 0
    made_names = {"-out.mcap", "-piped.mcap", "-dump", "-dump.mcap", "sweep", "-dataset"}
    assert made_names <= {path.name for path in tmp_path.iterdir()}


def limited(megabytes):
    return lambda: resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20, megabytes << 20))


@pytest.mark.promise("Start and end", "Too little memory under `ulimit -v` or `-d` gives one line and exit code 1")
@pytest.mark.skipif(sys.platform != "linux", reason="the system does not limit address space")
@pytest.mark.parametrize(
    ("command", "megabytes"),
    [
        *(("roadperc-replay", megabytes) for megabytes in (40, 95, 150, 400, 550)),
        *product(["roadperc-info"], [40, 150]),
        *product(["roadperc-report", "roadperc-sweep"], [95, 400]),
    ],
)
def test_too_little_memory_is_one_line(command, megabytes, made, tmp_path):
    arguments = {
        "roadperc-info": [SAMPLE],
        "roadperc-replay": [SAMPLE, "out.mcap", "--frames", "2"],
        "roadperc-report": [made / "run.mcap"],
        "roadperc-sweep": [SAMPLE, "--vary", "seed=1,2", "--frames", "1", "--jobs", "1"],
    }
    ended = run(command, *arguments[command], cwd=tmp_path, preexec_fn=limited(megabytes))
    if ended.returncode == 0:
        assert (megabytes >= 220, ended.stderr) == (True, "")
        return
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1)
    assert ended.stderr.startswith("error: ")
    assert not list(tmp_path.glob("out*"))


def test_a_process_that_finds_no_memory_for_a_library_is_one_line():
    code = "from roadperc_stream.cli import launch; launch._ended_under_limit = lambda command: 127 - launch._STATED; "
    words = [sys.executable, "-c", f"{code}raise SystemExit(launch._watched('replay'))"]
    ended = subprocess.run(words, check=False, capture_output=True, text=True, timeout=60)
    expected = "error: not enough memory under the limit that ulimit sets: the process ended with 127\n"
    assert (ended.returncode, ended.stderr) == (1, expected)


@pytest.mark.promise("Start and end", "Under `ulimit -v` or `-d` a signal ends the command as usual")
@pytest.mark.skipif(sys.platform != "linux", reason="the system does not limit address space")
@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_under_a_memory_limit_is_one_line(tmp_path, number):
    """The signal goes to the parent process, which the shell knows."""
    tmp_path.joinpath("rich.py").write_text("import os, time\nopen('begun', 'w').close()\ntime.sleep(20)\n")
    command = words("roadperc-report", "none.mcap")
    options = {"cwd": tmp_path, "env": environment(PYTHONPATH=str(tmp_path)), "preexec_fn": limited(16000)}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **options) as started:
        while started.poll() is None and not (tmp_path / "begun").exists():
            time.sleep(0.01)
        started.send_signal(number)
        assert (started.communicate(timeout=60)[1], started.returncode) == ("error: interrupted\n", 1)


@pytest.mark.promise("Start and end", "A signal while Python exits does not change the exit code")
@pytest.mark.parametrize(
    ("command", "number"), [*product(["roadperc-info"], SIGNALS), ("roadperc-sweep", signal.SIGINT)]
)
def test_a_signal_while_python_ends_leaves_the_exit_code(command, number, tmp_path):
    """Python deletes the objects of modules last, after it has removed its own handlers."""
    program, option, code = words(command)
    code = f"""import os, sys
class Deleted:
    def __del__(self, kill=os.kill, process=os.getpid()): kill(process, {int(number)})
sys.modules['deleted'] = Deleted()
{code}"""
    given = [program, option, code, *ENOUGH.get(command, ["in.mcap"])]
    ended = subprocess.run(given, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1)
    assert ended.stderr.startswith("error: ")


def test_a_live_replay_continues_without_a_reader_of_its_address(tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    command = words("roadperc-replay", SAMPLE, tmp_path / "out.mcap", "--frames", "2", "--live", "--port", "0")
    outputs = {"out.mcap", "out.metrics.parquet", "out.objects.parquet"}
    with subprocess.Popen(command, stdout=writing, stderr=subprocess.PIPE, text=True) as started:
        os.close(writing)
        while started.poll() is None and {path.name for path in tmp_path.iterdir()} != outputs:
            time.sleep(0.01)
        assert started.poll() is None  # it still serves
        started.send_signal(signal.SIGTERM)
        try:
            _, errors = started.communicate(timeout=60)
        finally:
            started.kill()
    assert errors in ("", "error: interrupted\n")  # the signal may arrive before it serves
    assert {path.name for path in tmp_path.iterdir()} == outputs


def test_a_closed_stream_does_not_take_the_number_of_a_file(tmp_path):
    code = "from roadperc_stream.cli.launch import _open_closed_streams as mend; mend();"
    code += (
        f"file = open({str(tmp_path / 'file')!r}, 'w'); print('astray', flush=True); print(file.fileno(), file=file)"
    )
    subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", sys.executable, "-c", code], check=True)
    assert int((tmp_path / "file").read_text()) > 2


@pytest.mark.parametrize("command", ["roadperc-info", "roadperc-report"])
@pytest.mark.parametrize("name", ["bad\udcff", "\u00fc"])
def test_a_name_of_another_encoding_is_one_line_at_most(command, name, made, tmp_path):
    for suffix in (".mcap", ".metrics.parquet", ".objects.parquet"):
        (tmp_path / f"{name}{suffix}").write_bytes((made / f"run{suffix}").read_bytes())
    plain = environment(LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0")
    ended = run(command, tmp_path / f"{name}.mcap", env=plain)
    assert "Traceback" not in ended.stderr
    assert (ended.returncode, ended.stderr.count("\n")) in {(0, 0), (1, 1)}
    assert ended.returncode == 0 or re.match(r"error: .*(bad|\\udcc3).*\n", ended.stderr), ended.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "printed"),
    [
        (["--help"], 0, "\n  replay      replay a log through the perception chain\n"),
        (["replay", "--version"], 0, "roadperc replay "),
        (["--version"], 0, "roadperc "),
        (["repaly", "in.mcap", "--force"], 2, "roadperc: error: no command 'repaly'; did you mean replay?\n"),
        ([], 2, "roadperc: error: the following arguments are required: COMMAND\n"),
        (["replay", "--forc"], 2, "roadperc replay: error: unrecognized arguments: --forc; did you mean --force?\n"),
        (["info", "none.mcap"], 1, "error: none.mcap: No such file or directory\n"),
    ],
)
def test_subcommands_have_the_name_that_was_typed(arguments, code, printed):
    ended = run_forked("roadperc", *arguments)
    assert (ended.returncode, printed in ended.stdout + ended.stderr) == (code, True), ended
    assert "roadperc-" not in ended.stderr


@pytest.mark.parametrize("command", COMMANDS)
def test_a_misspelled_option_gets_a_suggestion(command):
    ended = run_forked(f"roadperc-{command}", "--versio")
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.endswith("unrecognized arguments: --versio; did you mean --version?\n")


def test_an_error_of_a_command_names_its_option(made):
    ended = run_forked("roadperc-replay", SAMPLE, made / "run.mcap", "--frames", "1")
    assert ended.stderr.endswith("run.mcap: exists; pass --force to overwrite it\n")
    with pytest.raises(TargetError, match=r"run\.mcap: exists; pass force=True to overwrite it$"):
        api.replay(SAMPLE, made / "run.mcap", max_frames=1)
