"""A full disk: every command that writes prints one line with the file, and leaves no partial file.

A limit on the size of files replaces the disk; its signal is ignored, so that writing fails.
"""

import re

import pytest

from roadperc_stream.cli import render, replay
from tests.commands import run_forked
from tests.test_sample import SAMPLE

_LEAST_BYTES = 1500


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    assert replay.main([str(SAMPLE), str(folder / "run.mcap"), "--frames", "3", "--quiet"]) == 0
    assert render.main([str(folder / "dump"), "--size", "160x120", "--seconds", "0.2"]) == 0
    return folder


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("roadperc-replay", [SAMPLE, "OUT/run.mcap", "--frames", "2"]),
        ("roadperc-view", ["MADE/run.mcap", "--save", "OUT/run.rrd"]),
        ("roadperc-convert", ["MADE/dump", "OUT/dump.mcap"]),
        ("roadperc-render", ["OUT/dump", "--size", "160x120", "--seconds", "0.1"]),
        ("roadperc-report", ["MADE/run.mcap", "--html", "OUT/report.html"]),
        ("roadperc-compare", ["OUT/reference", "MADE/run.metrics.parquet", "--update-reference"]),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_full_disk_is_one_line_and_leaves_no_file(command, arguments, made, tmp_path):
    words = [re.sub("^MADE", str(made), re.sub("^OUT", str(tmp_path), str(argument))) for argument in arguments]
    ended = run_forked(command, *words, file_bytes=_LEAST_BYTES)
    assert ended.returncode == (3 if command == "roadperc-compare" else 1)
    assert ended.stderr.startswith(f"error: {tmp_path}/")
    assert ended.stderr.count("\n") == 1
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
