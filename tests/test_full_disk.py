"""A disk that is full: every command that writes says in one line which file it could not, and leaves none behind.

A limit on the size of files stands in for the disk; its signal is ignored, so that writing fails.
"""

import re
import resource
import signal
import subprocess
import sys

import pytest

from tests.test_sample import SAMPLE

_LEAST_BYTES = 1500


def roadperc(command, *arguments, limit=resource.RLIM_INFINITY):
    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    code = f"import sys; from roadperc_stream.cli.{command} import main; sys.exit(main(sys.argv[1:]))"
    words = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(words, check=False, capture_output=True, text=True, timeout=120, preexec_fn=limited)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    drive = ("render", folder / "drive", "--size", "160x120", "--seconds", "0.2")
    for command, *arguments in (("replay", SAMPLE, folder / "run.mcap"), drive):
        ended = roadperc(command, *arguments)
        assert ended.returncode == 0, ended.stderr
    return folder


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("replay", [SAMPLE, "OUT/run.mcap", "--frames", "2"]),
        ("replay", [SAMPLE, "OUT/run.mcap", "--frames", "2", "--live", "--port", "0"]),
        ("view", ["MADE/run.mcap", "--save", "OUT/run.rrd"]),
        ("view", ["MADE/run.mcap", "--video", "OUT/run.mp4"]),
        ("view", ["--foxglove-layout", "OUT/layout.json"]),
        ("convert", ["MADE/drive", "OUT/drive.mcap"]),
        ("render", ["OUT/drive", "--size", "160x120", "--seconds", "0.1"]),
        ("report", ["MADE/run.mcap", "--html", "OUT/report.html"]),
        ("lanes", ["MADE/run.mcap", "--tusimple", "OUT/lanes.json"]),
        ("trajectory", ["MADE/run.mcap", "--export-tum", "OUT/paths"]),
        ("trajectory", ["MADE/run.mcap", "--export-kitti", "OUT/paths"]),
        ("compare", ["OUT/reference", "MADE/run.metrics.parquet", "--update-reference"]),
        ("sweep", [SAMPLE, "--vary", "lanes.model=line", "--frames", "2", "--jobs", "1", "--out", "OUT/sweep"]),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_full_disk_is_one_line_and_leaves_no_file(command, arguments, made, tmp_path):
    words = [re.sub("^MADE", str(made), re.sub("^OUT", str(tmp_path), str(argument))) for argument in arguments]
    ended = roadperc(command, *words, limit=_LEAST_BYTES)
    assert ended.returncode == 1
    assert ended.stderr.startswith(f"error: {tmp_path}/")
    assert ended.stderr.count("\n") == 1
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
