"""Every command escapes text from files before it prints it."""

import json
import shutil

import pytest

from roadperc_stream.cli import check, report
from roadperc_stream.system.text import shown
from tests.commands import run_forked
from tests.eval.tables import outcome, row, write
from tests.hostile.inputs import COMMANDS, EVIL, SHOWN, taint, topic_options, write_log

pytestmark = pytest.mark.commands


def require_plain(done, *, names=SHOWN, codes=(0,)):
    """Require the exit code, the name in the output, and no control characters."""
    for text in (done.stdout, done.stderr):
        assert not COMMANDS & set(text), repr(text)
    assert done.returncode in codes, done.stderr
    assert "Traceback" not in done.stderr
    assert names in done.stdout + done.stderr


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """A hostile log and its replay, which prints its names."""
    folder = tmp_path_factory.mktemp("hostile")
    source, target = write_log(folder / "in.mcap"), folder / "out.mcap"
    require_plain(run_forked("roadperc-replay", source, target, "--set", "tag_table=0.9.13", *topic_options()))
    return source, target


def test_every_control_character_is_escaped():
    assert shown(EVIL) == SHOWN
    assert shown("straße 車 → ±") == "straße 車 → ±"
    for code in (*range(32), *range(127, 161), 0x200E, 0x2028, 0x2029, *range(0x2066, 0x206A), 0xDCFF, 0xE0001):
        assert shown(chr(code)).isascii()
        assert shown(chr(code)).isprintable()


def test_a_long_line_is_cut():
    assert len(shown("x" * 100_000_000)) < 10_100


@pytest.fixture(scope="module")
def folder(replayed, tmp_path_factory):
    """A folder with everything that the commands below read: logs, a table and a dump with hostile names and texts."""
    folder = tmp_path_factory.mktemp("commands")
    source, target = replayed
    shutil.copy(source, folder / "in.mcap")
    for name in ("out", EVIL[:7], "tainted"):
        for path in target.parent.glob("out.*"):
            shutil.copy(path, folder / path.name.replace("out.", f"{name}."))
    taint(folder / "tainted.metrics.parquet")
    (folder / "logs").mkdir()
    shutil.copy(source, folder / "logs" / f"{EVIL[:7]}.mcap")
    (folder / "dump" / f"rgb{EVIL}").mkdir(parents=True)
    (folder / "dump" / f"rgb{EVIL}" / "1.png").write_bytes(b"no image")
    return folder


PRINTED = {
    "info": (("in.mcap",), SHOWN, 0),
    "info as JSON": (("in.mcap", "--json"), r"\u001b[31m", 0),
    "report": (("tainted.metrics.parquet", "--html", "a.html"), SHOWN, 0),
    "compare": (("out.mcap", "tainted.mcap", "--full"), SHOWN, None),
    "batch": (("dataset", "logs", "--timeout", "0.001", *topic_options()), r"\x1b", 1),
    "convert": (("dump", "converted.mcap"), r"\x1b[31m", 1),
    "replay with wrong usage": (("a.mcap", "b.mcap", f"--{EVIL}"), SHOWN, 2),
}
"""Arguments of each command, the text it prints, and its exit code; None if that may be 0 or 1."""


@pytest.mark.parametrize("case", PRINTED)
def test_every_command_prints_escaped_text(folder, case):
    arguments, names, code = PRINTED[case]
    done = run_forked(f"roadperc-{case.split()[0]}", *arguments, cwd=folder)
    require_plain(done, names=names, codes=(0, 1) if code is None else (code,))
    if case == "info as JSON":
        assert any(EVIL in channel["topic"] for channel in json.loads(done.stdout)["channels"])
    if case == "report":
        assert "\x1b" not in (folder / "a.html").read_text()


def test_names_in_results_for_pages_are_escaped(tmp_path, capsys):
    name = f"<img src=x onerror=alert(1)>&#x202e;{EVIL[:10]}{EVIL[-8:]}"
    table = write(tmp_path / f"{name}.metrics.parquet", [row(k, lane_left_status=name) for k in range(3)])
    (tmp_path / "c.toml").write_text("[[criterion]]\ncolumn = 'frame'\nstatistic = 'max'\nmost = 1\nper_log = true\n")
    files = ("--markdown", tmp_path / "a.md", "--junit", tmp_path / "a.xml")
    for main, *options in ((report.main, "--by", "lane_left_status"), (check.main, "--criteria", tmp_path / "c.toml")):
        outcome(main, capsys, table, *options, *files)
        for path in (tmp_path / "a.md", tmp_path / "a.xml"):
            text = path.read_text("utf-8")
            assert not COMMANDS & set(text)
            assert "<img" not in text
            assert "&#x202e;" not in text
        assert "&lt;img" in (tmp_path / "a.md").read_text("utf-8")
    assert "&lt;img" in (tmp_path / "a.xml").read_text("utf-8")
