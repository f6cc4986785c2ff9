"""Masks by class from the outputs of segmentation networks, and grids of YOLOX."""

import numpy as np
import pytest

from roadperc_stream.errors import ConfigError
from roadperc_stream.tools.networks import detected_boxes
from roadperc_stream.tools.networks.frames import Loaded, Pair, class_masks
from roadperc_stream.tools.networks.semantic import HorizonEstimate
from tests.tools.networks.test_detected_boxes import TEXT, described

IMAGE = np.zeros((8, 16, 3), np.uint8)
INPUT = TEXT.replace("[64, 32]", "[16, 8]")


class Fixed:
    """A session with the same outputs for every image."""

    runtime = "fixed"

    def __init__(self, *outputs):
        self.outputs = list(outputs)

    def run(self, _pixels):
        return self.outputs


def segmenting(folder, output):
    return described(folder, INPUT.partition("output")[0] + f"output = {{ {output} }}")


def test_channels_of_one_class_are_one_class_and_others_have_none(tmp_path):
    network = segmenting(tmp_path / "a", 'decoder = "semantic", classes = { 1 = "road", 2 = "road", 3 = "car" }')
    scores = np.zeros((1, 5, 8, 16), np.float32)
    for channel in range(5):
        scores[0, channel, :, 3 * channel : 3 * channel + 3] = 1
    session, keys = Fixed(scores), network.keys.output
    masks = class_masks(Loaded(network, keys, session), IMAGE)
    assert {name: np.flatnonzero(mask.all(axis=0)).tolist() for name, mask in masks.items()} == {
        "road": [3, 4, 5, 6, 7, 8],
        "car": [9, 10, 11],
    }
    pair = Pair(Loaded(network, keys, session))
    _, found = pair.results(pair.raw(IMAGE), HorizonEstimate(), 1.5)
    assert found.detections is None
    assert [keys.table.name_of(tag) for tag in found.tags[4]] == ["unlabeled"] * 3 + ["road"] * 6 + ["car"] * 3 + [
        "unlabeled"
    ] * 4
    with pytest.raises(ConfigError, match=r"is \[1, 3, 8, 16\].*\[1, 4 or more, rows, columns\]"):
        class_masks(Loaded(network, keys, Fixed(scores[:, :3])), IMAGE)


def test_a_head_has_two_channels_or_one(tmp_path):
    network = segmenting(tmp_path / "a", 'decoder = "heads", classes = { a = "road", b = "road_line" }')
    two, one = np.zeros((1, 2, 8, 16), np.float32), np.full((1, 1, 8, 16), -1, np.float32)
    two[0, 1, 4:], one[0, 0, :, 8:] = 1, 1
    masks = class_masks(Loaded(network, network.keys.output, Fixed(two, one)), IMAGE)
    assert masks["road"][5:].all()
    assert not masks["road"][:4].any()
    assert np.flatnonzero(masks["road_line"].all(axis=0)).tolist() == list(range(8, 16))
    wrong = Fixed(two, np.zeros((1, 3, 8, 16), np.float32))
    with pytest.raises(ConfigError, match="1 or 2, rows"):
        class_masks(Loaded(network, network.keys.output, wrong), IMAGE)


def test_an_unknown_class_of_a_segmentation_is_an_error(tmp_path):
    with pytest.raises(ConfigError, match=r"net\.toml: class 'raod' is in no tag table; known: .*road"):
        segmenting(tmp_path / "a", 'decoder = "semantic", classes = { 1 = "raod" }')
    with pytest.raises(ConfigError, match="expected numbers of channels as keys, found street"):
        segmenting(tmp_path / "b", 'decoder = "semantic", classes = { street = "road" }')
    with pytest.raises(ConfigError, match=r"output\.decoder: expected one of 'semantic', 'heads'.*found 'yolo'"):
        segmenting(tmp_path / "c", 'decoder = "yolo", classes = { 1 = "road" }')


def test_a_cell_of_a_grid_is_a_box_at_its_place(tmp_path):
    text = TEXT.replace("yolov8", "yolo_grid")
    network = described(tmp_path / "a", text)
    raw = np.zeros((1, 4 * 8 + 2 * 4 + 1 * 2, 7), np.float32)
    raw[0, 32 + 5] = [0.5, 0.25, np.log(2), 0, 0.8, 0, 0.5]  # stride 16, row 1, column 1
    found = detected_boxes.decoded(network, network.keys.output, [raw])
    assert found.corners == pytest.approx(np.array([[8, 12, 40, 28]]))
    assert found.scores == pytest.approx([0.4])
    assert found.classes.tolist() == [1]
    with pytest.raises(ConfigError, match=r"is \[1, 41, 7\].*\[1, 42, 7 or more\]"):
        detected_boxes.decoded(network, network.keys.output, [raw[:, 1:]])
