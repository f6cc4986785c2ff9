"""ONNX files and descriptions of networks that cannot be used give one error, within limits of memory and time."""

import os
import signal
import subprocess
import time

import cv2
import numpy as np
import pytest

from roadperc_stream.cli.infer import main
from tests import commands
from tests.tools.networks import onnx_files as onnx
from tests.tools.networks.onnx_files import IMAGE, RANDOM, SAME, constant, info, model, node, tensor

SEGMENTATION = '[output]\ndecoder = "semantic"\nclasses = { 1 = "road" }\n'
DETECTION = '[output]\ndecoder = "yolo_grid"\nclasses = { 0 = "car" }\n'
HUGE = (80, 3, 2**12, 2**12)
"""Shape of a constant of 16 GB."""


NO_OUTPUTS = model([node("Relu", ["image"], ["y"])], [])
SEQUENCE = model([node("SequenceConstruct", ["image"], ["y"])], [info("y")])
WORDS = model([node("Cast", ["image"], ["y"], to=8)], [info("y", tensor(IMAGE, 8))])
FAILING = model([node("Reshape", ["image", "shape"], ["y"])], [info("y")], [constant("shape", 7, 7)])
FAILING_AT_RUN = model(
    [
        node("NonZero", ["image"], ["found"]),
        node("Cast", ["found"], ["real"], to=1),
        node("Reshape", ["real", "shape"], ["y"]),
    ],
    [info("y")],
    [constant("shape", 7, 7)],
)
EXPANDING = model(
    [node("ConstantOfShape", ["shape"], ["big"]), node("Sin", ["big"], ["y"])], [info("y")], [constant("shape", *HUGE)]
)
EXPANDING_AT_RUN = model([node("Tile", ["image", "shape"], ["y"])], [info("y")], [constant("shape", 9, 1, 2**9, 2**9)])
"""Its result has 3.6 GB."""


def described(folder, onnx_bytes, output=SEGMENTATION, file="net.onnx", size=(16, 8)):
    (folder / "net.onnx").write_bytes(onnx_bytes)
    path = folder / "net.toml"
    path.write_text(f'file = "{file}"\n[input]\nsize = {list(size)}\n{output}')
    cv2.imwrite(str(folder / "image.png"), np.arange(8 * 16 * 3, dtype=np.uint8).reshape(8, 16, 3))
    return ["--check", str(path), str(folder / "image.png"), str(folder / "seen.png")]


def error_of(capsys):
    """The only line that a command printed."""
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    return line


@pytest.mark.parametrize(
    ("onnx_bytes", "words"),
    [
        (b"", "cannot load it"),
        (SAME[: len(SAME) // 2], "cannot load it"),
        (NO_OUTPUTS, "outputs"),
        (SEQUENCE, "output y is seq(tensor(float))"),
        (WORDS, "output y is tensor(string)"),
        (FAILING, "cannot"),
        (FAILING_AT_RUN, "cannot run it"),
        (model([node("NoSuchOperation", ["image"], ["y"])], [info("y")]), "cannot load it"),
    ],
    ids=["empty", "cut", "no outputs", "sequence", "text", "failing", "failing at run", "unknown"],
)
def test_a_model_that_cannot_be_run_is_one_error(tmp_path, capsys, onnx_bytes, words):
    assert main(described(tmp_path, onnx_bytes)) == 1
    line = error_of(capsys)
    assert "net.onnx" in line
    assert words in line


@pytest.mark.parametrize("onnx_bytes", [EXPANDING, EXPANDING_AT_RUN], ids=["constants", "results"])
def test_a_model_that_expands_is_one_error(tmp_path, onnx_bytes):
    with subprocess.Popen(commands.words("roadperc-infer", *described(tmp_path, onnx_bytes)), stderr=-1) as process:
        error = process.stderr.read().decode()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert (process.returncode, error.count("\n")) == (1, 1)
    assert "memory" in error
    assert used.ru_maxrss < 3 * 2**20  # KiB


def test_a_model_that_is_no_file_is_one_error(tmp_path, capsys):
    os.mkfifo(tmp_path / "fifo")
    for file, words in (("a\\u0000b", "null"), ("fifo", "expected a file"), (".", "expected a file")):
        assert main(described(tmp_path, SAME, file=file)) == 1
        assert words in error_of(capsys)


@pytest.mark.parametrize("strides", ["", "strides = [0]\n", "strides = [4]\n"])
def test_wrong_strides_are_one_error(tmp_path, capsys, strides):
    grid = model([node("Reshape", ["image", "shape"], ["y"])], [info("y")], [constant("shape", 1, 64, 6)])
    assert main(described(tmp_path, grid, DETECTION + strides)) == 1
    line = error_of(capsys)
    assert "strides" in line or "of boxes" in line


def test_random_numbers_are_told(tmp_path, capsys):
    assert main(described(tmp_path, RANDOM)) == 0
    assert "net.onnx: output y differs between two runs" in capsys.readouterr().err
    assert main([*described(tmp_path, SAME), "--force"]) == 0
    assert capsys.readouterr().err == ""


def test_an_endless_model_can_be_interrupted(tmp_path):
    process = subprocess.Popen(commands.words("roadperc-infer", *described(tmp_path, onnx.endless())), stderr=-1)
    time.sleep(2.5)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    try:
        _, error = process.communicate(timeout=2)
    finally:
        process.kill()
    assert (process.returncode, error.count(b"\n")) == (1, 1)
    assert not list(tmp_path.glob("*seen*"))
