"""What came from a file reaches the terminal escaped, whichever command prints it."""

import json
import re
import shutil
import signal
import subprocess
import sys

import pytest

from roadperc_stream.system.text import shown
from tests.commands import run, words
from tests.hostile.inputs import COMMANDS, EVIL, SHOWN, taint, topic_options, write_log
from tests.view.live.client import Viewer

pytestmark = pytest.mark.commands


def require_plain(done, *, names=SHOWN, codes=(0,)):
    """No character that a terminal obeys, and the name is there."""
    for text in (done.stdout, done.stderr):
        assert not COMMANDS & set(text), repr(text)
    assert done.returncode in codes, done.stderr
    assert "Traceback" not in done.stderr
    assert names in done.stdout + done.stderr


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """A hostile log, its replay, and what the replay printed."""
    folder = tmp_path_factory.mktemp("hostile")
    source, target = write_log(folder / "in.mcap"), folder / "out.mcap"
    done = run("roadperc-replay", source, target, "--set", "tag_table=0.9.13", *topic_options())
    return source, target, done


@pytest.fixture(scope="module")
def tainted(replayed):
    """The replay's folder with its table's texts replaced, and a log that is called so."""
    _, target, _ = replayed
    folder = target.parent / "tainted"
    folder.mkdir()
    for path in target.parent.glob("out.*"):
        shutil.copy(path, folder / path.name)
    taint(folder / "out.metrics.parquet")
    return folder


@pytest.mark.promise("The terminal", "Text from files is printed with control characters escaped (`system.text.shown`)")
def test_no_sign_that_a_terminal_obeys_is_left():
    assert shown(EVIL) == SHOWN
    assert shown("straße 車 → ±") == "straße 車 → ±"
    for code in (*range(32), *range(127, 161), 0x200E, 0x2028, 0x2029, *range(0x2066, 0x206A), 0xDCFF, 0xE0001):
        assert shown(chr(code)).isascii()
        assert shown(chr(code)).isprintable()


@pytest.mark.promise("The terminal", "A line is cut after 10,000 characters")
def test_a_line_of_a_hundred_million_characters_is_cut():
    assert len(shown("x" * 100_000_000)) < 10_100


@pytest.mark.promise("The terminal", "`roadperc-replay` prints escaped text")
def test_replay(replayed):
    require_plain(replayed[2])


@pytest.mark.promise("The terminal", "Errors are escaped")
def test_a_stated_error():
    require_plain(run("roadperc-replay", f"no-{EVIL}.mcap", "out.mcap"), names=r"\x1b[31m", codes=(1,))


@pytest.mark.promise("The terminal", "Usage errors are escaped")
def test_wrong_usage():
    require_plain(run("roadperc-replay", "a.mcap", "b.mcap", f"--{EVIL}"), names=SHOWN, codes=(2,))


@pytest.mark.promise("The terminal", "`roadperc-info` prints escaped text")
def test_info(replayed):
    source, target, _ = replayed
    require_plain(run("roadperc-info", source))
    require_plain(run("roadperc-info", target))
    done = run("roadperc-info", source, "--json")
    require_plain(done, names=r"\u001b[31m")
    assert any(EVIL in channel["topic"] for channel in json.loads(done.stdout)["channels"])


@pytest.mark.promise("The terminal", "`roadperc-view` prints escaped text")
def test_view(replayed, tmp_path):
    require_plain(run("roadperc-view", replayed[0], "--save", tmp_path / f"{EVIL[:7]}.rrd"), names=r"\x1b")
    require_plain(run("roadperc-view", replayed[1], "--video", tmp_path / f"{EVIL[:7]}.mp4"), names=r"\x1b")


@pytest.mark.promise("The terminal", "`roadperc-report` prints escaped text")
def test_report(tainted, replayed, tmp_path):
    require_plain(run("roadperc-report", tainted / "out.metrics.parquet", "--html", tmp_path / "a.html"))
    assert "\x1b" not in (tmp_path / "a.html").read_text()
    require_plain(run("roadperc-report", tainted, replayed[1].with_suffix(".metrics.parquet")))


@pytest.mark.promise("The terminal", "`roadperc-compare` prints escaped text")
def test_compare(tainted, replayed):
    require_plain(run("roadperc-compare", replayed[1], tainted / "out.mcap"), codes=(0, 1))


@pytest.mark.promise("The terminal", "`roadperc-sweep` prints escaped text")
def test_sweep(replayed, tmp_path):
    options = ["--vary", "lanes.hold_s=0.5,0.6", "--set", "tag_table=0.9.13", "--out", tmp_path / "sweep"]
    require_plain(run("roadperc-sweep", replayed[0], *options, *topic_options()))


def test_batch(replayed, tmp_path):
    shutil.copy(replayed[0], tmp_path / f"{EVIL[:7]}.mcap")
    failed = run("roadperc-batch", tmp_path / "dataset", tmp_path, "--timeout", "0.001", *topic_options())
    require_plain(failed, names=r"\x1b", codes=(1,))


@pytest.mark.promise("The terminal", "`roadperc-trajectory` and `roadperc-lanes` print escaped text")
def test_trajectory_and_lanes(replayed):
    hostile = replayed[1].with_name(f"{EVIL[:7]}.mcap")
    for path in replayed[1].parent.glob("out.*"):
        shutil.copy(path, path.with_name(path.name.replace("out.", f"{EVIL[:7]}.")))
    require_plain(run("roadperc-trajectory", hostile), names=r"\x1b", codes=(0, 1))
    require_plain(
        run("roadperc-lanes", hostile, "--tusimple", hostile.with_suffix(".json")), names=r"\x1b", codes=(0, 1)
    )


@pytest.mark.promise("The terminal", "`roadperc-convert` prints escaped text")
def test_convert(tmp_path):
    (tmp_path / f"rgb{EVIL}").mkdir()
    (tmp_path / f"rgb{EVIL}" / "1.png").write_bytes(b"no image")
    require_plain(run("roadperc-convert", tmp_path, tmp_path / "out.mcap"), names=r"\x1b[31m", codes=(1,))


@pytest.mark.promise("The terminal", "Text that a client sends to the live server is escaped when the SDK logs it")
def test_what_a_client_of_the_live_server_sends(replayed):
    """The SDK of the server logs what is wrong with a message, in the client's own words."""
    command = words("roadperc-view", replayed[1], "--foxglove", "--port", 0)
    with subprocess.Popen(command, stdout=-1, stderr=-1, text=True) as server:
        port = int(re.search(r"ws://127\.0\.0\.1:(\d+) ", server.stdout.readline())[1])
        with Viewer(port) as viewer:
            viewer.socket.send(json.dumps({"op": EVIL}))
            viewer.socket.send(json.dumps({"op": "fetchAsset", "requestId": EVIL, "uri": EVIL}))
            viewer.until(lambda: len(viewer.warnings) == 2)
            assert viewer.control(play=False, request_id=EVIL).request_id == EVIL
        server.send_signal(signal.SIGINT)
        out, err = server.communicate(timeout=60)
    require_plain(subprocess.CompletedProcess(command, server.returncode, out, err))
    assert len(err.splitlines()) == 2


LIBRARY = """
import logging, sys
from roadperc_stream.cli.plumbing import run

def command():
    if sys.argv[2] == "own handler":
        logging.basicConfig()
    try:
        raise ValueError(sys.argv[1])
    except ValueError:
        logging.getLogger("library").exception("it said %s", sys.argv[1])

sys.exit(run(command))
"""


@pytest.mark.promise("The terminal", "Log records of libraries are escaped, whichever handler prints them")
@pytest.mark.parametrize("handler", ["own handler", "no handler"])
def test_what_a_library_logs(handler):
    done = subprocess.run([sys.executable, "-c", LIBRARY, EVIL, handler], check=False, capture_output=True, timeout=60)
    err = done.stderr.decode()
    assert not COMMANDS & set(err), repr(err)
    assert [f"it said {SHOWN}" in err, f"ValueError: {SHOWN}" in err] == [True, True]
    assert len(err.splitlines()) == 2
