"""Mistakes in dumps are named; the other files are converted."""

import json
import os
import signal
import subprocess
import time

import cv2
import numpy as np
import pytest

from roadperc_stream import log
from roadperc_stream.errors import DumpError
from roadperc_stream.system.time import NS_PER_S
from roadperc_stream.tools.readers.frame_stamps import EPOCH_NS, stamps_of_file
from tests.commands import run_forked, words

pytestmark = pytest.mark.commands
TIME_NS = 1_403_636_579_763_555_584


def dump(folder, names=("1", "2", "3"), sizes=((64, 48),) * 3, calibration=None):
    (folder / "rgb").mkdir(parents=True)
    for name, (width, height) in zip(names, sizes, strict=True):
        cv2.imwrite(str(folder / "rgb" / f"{name}.png"), np.full((height, width, 3), 90, np.uint8))
    document = {"width": 64, "height": 48, "fov_deg": 90} | (calibration or {})
    (folder / "calibration.json").write_text(json.dumps(document))
    return folder


def convert(folder):
    return run_forked("roadperc-convert", folder, folder.parent / "out.mcap", "--force")


def stamps(folder):
    target = folder.parent / "out.mcap"
    return [m.log_time_ns for m in log.read(log.summarise(target), topics=["/camera/front/image"])]


STAMPED = ("1305031102.933", "1305031102.983", "1305031103.033")
REPORTED = {
    "misspelled key": ({"calibration": {"rate_Hz": 10}}, 1, "unknown key rate_Hz; did you mean rate_hz?"),
    "misspelled width": ({"calibration": {"widht": 64}}, 1, "unknown key widht; did you mean width?"),
    "misspelled key of a camera": (
        {"calibration": {"cameras": {"depth": {"hieght": 4}}}},
        1,
        "unknown key cameras.depth.hieght; did you mean height?",
    ),
    "first size": ({"sizes": ((32, 48), (64, 48), (64, 48))}, 0, "1.png: image is 32x48, expected 64x48 as its camera"),
    "last size": ({"sizes": ((64, 48), (64, 48), (32, 48))}, 0, "3.png: image is 32x48, expected 64x48 as its camera"),
    "every size": ({"sizes": ((32, 48),) * 3}, 1, "image is 32x48, expected 64x48 as its camera"),
    "counts and times": (
        {"names": ("1", "2", "1305031102.933")}, 1, "names of two kinds, such as 1 and 1305031102933000000"
    ),
    "rate beside stamps": (
        {"names": STAMPED, "calibration": {"rate_hz": 5}}, 0,
        "rate_hz 5 of the calibration is not used: the names of the files are stamps",
    ),
}  # fmt: skip
"""The faulty dump, and the converter's exit code and message."""


@pytest.mark.parametrize(("options", "code", "message"), REPORTED.values(), ids=REPORTED)
def test_a_mistake_in_a_dump_is_reported(tmp_path, options, code, message):
    done = convert(dump(tmp_path / "dump", **options))
    assert (done.returncode, message in done.stdout + done.stderr) == (code, True), done.stderr
    if "sizes" in options and code == 0:
        assert len(stamps(tmp_path / "dump")) == 2


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ("frame,timestamp,x\n1,0.5,7\n2,0.6,7\n3,0.75,7\n", [EPOCH_NS + t * 1_000_000 for t in (500, 600, 750)]),
        ("x,stamp_ns,filename\n9,100,rgb/3.png\n9,50,rgb/2.png\n9,7,rgb/1.png\n", [EPOCH_NS + t for t in (7, 50, 100)]),
        (f"#timestamp [ns],filename\n{TIME_NS},1.png\n{TIME_NS + 5},2.png\n{TIME_NS + 9},3.png\n", None),
    ],
    ids=["seconds", "files", "EuRoC"],
)
def test_stamps_are_found_by_the_name_of_their_column(tmp_path, table, expected):
    path = tmp_path / "timestamps.csv"
    path.write_text(table)
    found = list(stamps_of_file(path, [1, 2, 3]).values())
    assert found == [int(ns) for ns in expected or (TIME_NS, TIME_NS + 5, TIME_NS + 9)]


def test_a_table_without_stamps_is_an_error(tmp_path):
    path = tmp_path / "timestamps.csv"
    path.write_text("frame,gain\n1,2\n")
    with pytest.raises(DumpError, match="columns 'frame,gain': expected one of timestamp"):
        stamps_of_file(path, [1])
    path.write_text("frame,timestamp\n1,nan\n")
    with pytest.raises(DumpError, match="line 2: expected a time in column 2"):
        stamps_of_file(path, [1])


def test_the_stamps_of_euroc_are_read(tmp_path):
    folder = dump(tmp_path / "dump")
    (folder / "rgb").rename(folder / "data")
    (folder / "rgb").mkdir()
    (folder / "data").rename(folder / "rgb" / "data")
    rows = "".join(f"{TIME_NS + k * NS_PER_S},{k}.png\n" for k in (1, 2, 3))
    (folder / "rgb" / "data.csv").write_text(f"#timestamp [ns],filename\n{rows}")
    done = convert(folder)
    assert done.returncode == 0, done.stderr
    assert stamps(folder) == [TIME_NS + k * NS_PER_S for k in (1, 2, 3)]


def test_unused_files_with_stamps_are_reported(tmp_path):
    folder = dump(tmp_path / "dump")
    (folder / "metadata.json").write_text('{"1": {"timestamp": 5}}')
    (folder / "rgb" / "metadata.json").write_text('{"1": {"timestamp": 5}}')
    done = convert(folder)
    assert "metadata.json is not used" in done.stdout
    assert "rgb/metadata.json is not used: put stamps into timestamps.txt or timestamps.csv" in done.stdout


def test_an_interrupted_render_keeps_its_target(tmp_path):
    folder = tmp_path / "dump"
    folder.mkdir()
    (folder / "truth.json").write_text("former")
    command = words("roadperc-render", folder, "--size", "320x240", "--seconds", "60", "--force")
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not any(tmp_path.glob(".*.partial/rgb/*.png")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGTERM)
    _, said = process.communicate(timeout=30)
    assert (process.returncode, said) == (1, "error: interrupted\n")
    assert list(tmp_path.rglob("*")) == [folder, folder / "truth.json"]
    assert (folder / "truth.json").read_text() == "former"


def test_a_render_replaces_an_earlier_one_and_keeps_other_files(tmp_path):
    folder = tmp_path / "dump"
    options = ("--size", "64x48", "--seconds", "0.05", "--force")
    assert run_forked("roadperc-render", folder, *options).returncode == 0
    (folder / "own.txt").write_text("own")
    (folder / "truth.json").write_text("former")
    assert run_forked("roadperc-render", folder, *options).returncode == 0
    assert (folder / "own.txt").read_text() == "own"
    assert json.loads((folder / "truth.json").read_text())["lanes"]
    assert [path.name for path in tmp_path.iterdir()] == ["dump"]
