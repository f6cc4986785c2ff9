"""ONNX files that cannot be used give one error with their name."""

import sys

import numpy as np
import pytest

from roadperc_stream.errors import ConfigError
from roadperc_stream.tools.networks.description import read_network
from roadperc_stream.tools.networks.session import open_session
from tests.tools.networks.onnx_files import IMAGE, SAME, model


def network(folder, onnx_bytes=SAME, output='decoder = "semantic"\nclasses = { 1 = "road" }', size="[16, 8]"):
    (folder / "net.onnx").write_bytes(onnx_bytes)
    (folder / "net.toml").write_text(f'file = "net.onnx"\n[input]\nsize = {size}\n[output]\n{output}\n')
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
    for wrong in (SAME[: len(SAME) // 2], model("NoSuchOperation")):
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
