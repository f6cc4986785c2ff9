"""ONNX files that cannot be used give one error with their name."""

import os
import signal
import subprocess
import sys

import cv2
import numpy as np
import pytest

from roadperc_stream.errors import ConfigError
from roadperc_stream.tools.networks.description import read_network
from roadperc_stream.tools.networks.session import open_session
from tests.tools.networks.onnx_files import IMAGE, SAME, model, node


def network(
    folder, onnx_bytes=SAME, output='decoder = "semantic"\nclasses = { 1 = "road" }', size="[16, 8]", file="net.onnx"
):
    (folder / "net.onnx").write_bytes(onnx_bytes)
    (folder / "net.toml").write_text(f'file = "{file}"\n[input]\nsize = {size}\n[output]\n{output}\n')
    return read_network(folder / "net.toml")


@pytest.mark.parametrize("extra", [True, False], ids=["onnxruntime", "OpenCV"])
def test_both_libraries_run_a_model_and_name_one_that_they_cannot_load(tmp_path, monkeypatch, extra):
    if not extra:
        monkeypatch.setitem(sys.modules, "onnxruntime", None)
    session = open_session(network(tmp_path))
    pixels = np.arange(np.prod(IMAGE), dtype=np.float32).reshape(IMAGE) - 100
    (found,) = session.run(pixels)
    assert np.array_equal(found, np.maximum(pixels, 0))
    assert session.runtime.startswith("onnxruntime" if extra else "cv2.dnn")
    for wrong in (SAME[: len(SAME) // 2], model(node("NoSuchOperation"))):
        with pytest.raises(ConfigError, match=r"net\.onnx: .* cannot load it"):
            open_session(network(tmp_path, wrong))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"size": "[8, 16]"},
            r"input image is \[1, 3, 8, 16\] tensor\(float\), but .*net\.toml describes \[1, 3, 16, 8\]",
        ),
        ({"output": 'decoder = "heads"\nclasses = { road = "road" }'}, r"outputs y, but .*net\.toml names road"),
    ],
)
def test_shapes_and_names_are_compared_with_the_description(tmp_path, changes, words):
    with pytest.raises(ConfigError, match=words):
        open_session(network(tmp_path, **changes))


@pytest.mark.parametrize(
    ("onnx_bytes", "words"),
    [
        (b"", "cannot load it"),
        (model(node("Relu"), outputs=()), "outputs"),
        (model(node("SequenceConstruct")), r"output y is seq\(tensor\(float\)\), expected a tensor of numbers"),
        (model(node("IsNaN")), r"output y is tensor\(bool\), expected a tensor of numbers"),
        (model(node("NonZero", output="x"), node("MatMul", "xx")), "cannot run it"),
    ],
    ids=["empty", "no outputs", "sequence", "truth values", "failing"],
)
def test_a_model_that_cannot_be_run_is_an_error(tmp_path, onnx_bytes, words):
    with pytest.raises(ConfigError, match=rf"net\.onnx: .*{words}"):
        open_session(network(tmp_path, onnx_bytes)).run(np.ones(IMAGE, np.float32))


@pytest.mark.parametrize(
    ("file", "words"), [("a\\u0000b", "null"), ("fifo", "expected a file"), (".", "expected a file")]
)
def test_a_model_that_is_no_file_is_an_error(tmp_path, file, words):
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(ConfigError, match=rf"{words}.*, named by .*net\.toml"):
        network(tmp_path, file=file)


ENDLESS = """
import sys, time
from roadperc_stream.cli.launch import infer
from roadperc_stream.tools.networks import session
session._OnnxSession.run = lambda *_: print("runs", flush=True) or time.sleep(600)
sys.exit(infer())
"""


def test_an_endless_model_can_be_interrupted(tmp_path):
    path = network(tmp_path).path
    cv2.imwrite(str(tmp_path / "image.png"), np.zeros((8, 16, 3), np.uint8))
    words = ["--check", str(path), str(tmp_path / "image.png"), str(tmp_path / "seen.png")]
    with subprocess.Popen([sys.executable, "-c", ENDLESS, *words], stdout=-1, stderr=-1) as process:
        assert process.stdout.readline() == b"runs\n"
        process.send_signal(signal.SIGINT)
        try:
            _, error = process.communicate(timeout=2)
        finally:
            process.kill()
    assert (process.returncode, error) == (1, b"error: interrupted\n")
    assert not list(tmp_path.glob("*seen*"))
