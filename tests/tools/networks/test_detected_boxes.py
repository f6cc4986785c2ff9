"""Boxes of detectors, and the description of their networks."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.errors import ConfigError
from roadperc_stream.model.tag_tables import table_of_classes
from roadperc_stream.tools.networks import detected_boxes
from roadperc_stream.tools.networks.description import DetectionKeys, InputKeys, Network, read_network
from roadperc_stream.tools.networks.detected_boxes import Boxes
from roadperc_stream.tools.networks.pixels import placement, require_orientation
from roadperc_stream.tools.networks.plausibility import RoadCheck

TEXT = """file = "model.onnx"
input = { size = [64, 32] }
output = { decoder = "yolov8", classes = { 0 = "person", 1 = "car" } }
"""


def described(folder: Path, text: str = TEXT) -> Network:
    folder.mkdir()
    folder.joinpath("model.onnx").write_bytes(b"model")
    folder.joinpath("net.toml").write_text(text)
    return read_network(folder / "net.toml")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("size =", "sise =", "no key input.sise; did you mean size?"),
        ('file = "model.onnx"', "", "file: missing"),
        ("output =", "outputs =", "no key outputs; did you mean output?"),
        ("input", 'sha256 = "' + "0" * 64 + '"\ninput', "download the file again"),
        ("classes", "strides = [0], classes", "output.strides[0]: "),
        ("model.onnx", "none.onnx", "none.onnx: No such file or directory, named by"),
    ],
)
def test_faults_of_a_description_name_file_and_key(tmp_path, old, new, words):
    with pytest.raises(ConfigError) as caught:
        described(tmp_path / "a b", TEXT.replace(old, new, 1))
    assert words in str(caught.value)
    assert str(tmp_path / "a b") in str(caught.value)


def test_yolov8_and_decoded_boxes_are_the_same_boxes(tmp_path):
    network = described(tmp_path / "a")
    raw = np.array([[[20, 10], [10, 10], [8, 4], [4, 4], [0.1, 0.2], [0.9, 0.1]]], np.float32)
    found = detected_boxes.decoded(network, network.keys.output, [raw])
    assert found.corners.tolist() == [[16, 8, 24, 12]]
    assert found.classes.tolist() == [1]
    text = TEXT.replace("yolov8", "boxes")
    network = described(tmp_path / "b", text)
    parts = [np.float32([[16, 8, 24, 12]]), np.float32([0.9]), np.float32([1])]
    for outputs in (parts, [np.float32([[[16, 8, 24, 12, 0.9, 1]]])]):
        assert detected_boxes.decoded(network, network.keys.output, outputs).corners.tolist() == found.corners.tolist()
    with pytest.raises(ConfigError, match=r"is \[1, 3, 5\].*expects \[1, N, 6\]"):
        detected_boxes.decoded(network, network.keys.output, [np.zeros((1, 3, 5), np.float32)])


def test_duplicates_nested_large_and_bonnet_boxes_are_left_out():
    keys = DetectionKeys(decoder="boxes", classes={0: "car", 1: "person"}, ignore_below=0.9)
    corners = [[0, 0, 20, 20], [1, 0, 21, 20], [2, 2, 8, 8], [2, 2, 8, 8], [0, 0, 90, 80], [50, 80, 60, 95]]
    made = Boxes(np.array(corners, float), np.array([0.9, 0.8, 0.7, 0.6, 0.5, 0.4]), np.array([0, 1, 0, 1, 1, 0]))
    kept = detected_boxes.without_duplicates(keys, made)
    assert kept.scores.tolist() == [0.9, 0.6, 0.4]
    assert detected_boxes.possible(keys, made, (100, 100)).scores.tolist() == [0.9, 0.8, 0.7, 0.6]


@given(st.sampled_from(["corner", "centre"]), st.integers(8, 2000), st.integers(8, 2000))
def test_a_letterbox_is_undone(align, columns, rows):
    place = placement(InputKeys(size=(416, 320), resize="letterbox", align=align), (columns, rows))
    box = np.array([[1.0, 2.0, 5.0, 7.0]])
    there = box * np.tile(place.scale, 2) + np.tile(place.offset, 2)
    assert place.in_image(there) == pytest.approx(box)


@pytest.mark.parametrize(
    ("input_size", "size", "expected"),
    [
        ((320, 320), (960, 540), ((1 / 3, 320 / 540), (0, 0))),
        ((320, 320), (1080, 540), ((320 / 1080, 320 / 540), (0, 0))),
        ((320, 320), (1280, 320), ((0.25, 0.5), (0, 80))),
        ((320, 320), (100_000, 1), ((0.0032, 0.0064), (0, 160))),
        ((640, 160), (1280, 320), ((0.5, 0.5), (0, 0))),
    ],
)
def test_an_image_wider_than_the_squeezed_ones_gets_borders(input_size, size, expected):
    place = placement(InputKeys(size=input_size), size)
    assert (place.scale, place.offset) == expected
    scores = np.zeros((1, *input_size[::-1]), np.float32)
    rows = max(round(size[1] * place.scale[1]), 1)
    assert place.cut(scores, input_size).shape == (1, rows, input_size[0])


def test_a_portrait_input_refuses_landscape_images(tmp_path):
    network = described(tmp_path / "a", TEXT.replace("[64, 32]", "[32, 64]"))
    with pytest.raises(ConfigError, match=r"32 columns and 64 rows is portrait.*96x54"):
        require_orientation(network, (96, 54))
    require_orientation(network, (54, 96))


def test_warnings_follow_from_the_first_twenty_frames():
    table, road = table_of_classes(("unlabeled", "road")), RoadCheck()
    tags = np.zeros((100, 90), np.uint8)
    tags[:40] = 1
    for _ in range(20):
        road.add(table, tags)
    road.add(table, 1 - tags)
    assert len(road.before) == 20
    before, above = road.warnings("net.onnx")
    assert "net.onnx: 0% of the road before the car" in before
    assert "100% of the image's upper 40%" in above
