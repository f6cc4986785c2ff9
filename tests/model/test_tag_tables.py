"""Tag tables against the documentation of CARLA and of the datasets."""

import numpy as np
import pytest

from roadperc_stream.config.settings import read_toml
from roadperc_stream.errors import ConfigError
from roadperc_stream.model import tag_tables as s
from roadperc_stream.model.frame import mark


@pytest.mark.parametrize(
    ("version", "tags"),
    [
        ("0.8.2", {"road_line": 6, "road": 7, "sidewalk": 8, "vehicle": 10, "traffic_sign": 12}),
        ("0.9.13", {"road": 7, "sky": 13, "terrain": 22, "pedestrian": 4}),
        ("0.9.14", {"road": 1, "sidewalk": 2, "car": 14, "road_line": 24, "pedestrian": 12, "guard_rail": 28}),
        ("0.9.15", {"sky": 11, "bicycle": 19, "other": 22}),
        ("0.10.0", {"road": 1}),
    ],
)
def test_tags_of_versions(version, tags):
    table = s.table_for_version(version)
    for name, tag in tags.items():
        assert table.names[tag] == name


@pytest.mark.parametrize(
    ("name", "tags"),
    [
        (
            "cityscapes",
            {"road": {7}, "sidewalk": {8}, "parking": {9}, "rail_track": {10}, "bicycle": {33}, "sky": {23}},
        ),
        (
            "mapillary-vistas-1.2",
            {"road": {13, 14, 36, 41, 43}, "crosswalk": {8, 23}, "parking": {10}, "rail_track": {12}, "car": {55}},
        ),
        (
            "mapillary-vistas-2.0",
            {
                "road": {21, 22, 23, 69, 74, 77},
                "sky": {61},
                "road_line": {*range(35, 45), *range(46, 56), 57, 58},
                "crosswalk": {14, 45, 56},
                "truck": {109, 112, 113, 114},
                "unlabeled": {118, 120, 123},
            },
        ),
        (
            "kitti-360",
            {
                "road": {7},
                "building": {11, 16, 34, 42},
                "pole": {17, 18, 37, 38},
                "truck": {27, 29, 30, 43},
                "car": {26},
            },
        ),
        ("bdd100k-drivable", {"road": {0, 1}, "unlabeled": {2}}),
        ("bdd100k-instances", {"unlabeled": {0}, "rider": {2}, "car": {3}, "bicycle": {8}}),
    ],
)
def test_tags_of_datasets(name, tags):
    table = s.table_for_version(name)
    assert {known: set(table.tags_of([known])) for known in tags} == tags


@pytest.mark.parametrize("name", ["cityscapes-train-ids", "bdd100k"])
def test_train_ids_are_the_classes_of_cityscapes_that_are_evaluated(name):
    """Source: trainId by id in labels.py of cityscapesScripts; 255 is every other class."""
    ids = [7, 8, 11, 12, 13, 17, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 31, 32, 33]
    table = s.table_for_version(name)
    assert table.names[:19] == tuple(s.table_for_version("cityscapes").names[number] for number in ids)
    assert (table.name_of(255), table.gaps) == ("unlabeled", frozenset(range(19, 255)))


def test_the_bits_of_lanes_in_bdd100k():
    """Source: eval/lane.py of bdd100k: category in bits 0 to 2, background in bit 3, style in 4, direction in 5."""
    table = s.table_for_version("bdd100k-lanes")
    for tag in range(256):
        kind = {0: "crosswalk", 4: "sidewalk"}.get(tag & 7, "road_line")
        lane = tag < 64 and not tag & 8
        assert (table.name_of(tag), tag in table.gaps) == (kind if lane else "unlabeled", not lane and tag < 255)


OWN = """
instances_per_tag = 100
[tags]
road = [1, 3]
car = 7
[colours]
car = "#FF00ff"
road = ["#010203", "#000000"]
"""


def test_a_table_of_ones_own_travels_as_its_classes(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(OWN)
    table = s.table_of(read_toml(path), str(path))
    assert table.names == ("unlabeled", "road", "unlabeled", "road", "unlabeled", "unlabeled", "unlabeled", "car")
    assert table.tag_by_colour == {(255, 0, 255): 7, (1, 2, 3): 1, (0, 0, 0): 1}
    assert (table.gaps, table.instances_per_tag, table.title) == ({0, 2, 4, 5, 6}, 100, str(path))
    read = s.table_named(table.name)
    assert (table.name, read.names) == (f"classes:{','.join(table.names)}", table.names)
    path.write_text("[tags]\nroad = 0\n")
    assert s.table_of(read_toml(path), str(path)).tag_by_colour == {(128, 64, 128): 0}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[tags]\nmotorway = 1", "class 'motorway' is in no tag table"),
        ("[tags]\nroad = 256", "tag 256: expected a whole number from 0 to 255"),
        ("[tags]\nroad = [1, true]", "tag True"),
        ("[tags]\nroad = 1\ncar = [2, 1]", "1 is both road and car"),
        ('[tags]\nroad = 1\n[colours]\nroad = "red"', "colour 'red': expected one such as"),
        ('[tags]\nroad = 1\n[colours]\ncar = "#000000"', "car has colours, but no tag"),
        ("road = 1", "expected [tags]"),
        ("tags = 1", "no attribute 'items'"),
        ("[tags", "at end of document"),
    ],
)
def test_a_wrong_table_is_named(tmp_path, text, words):
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as fault:
        s.table_of(read_toml(path), str(path))
    assert str(fault.value).startswith(f"{path}: ")
    assert words in str(fault.value)


@pytest.mark.parametrize("table", [s.table_for_version(name) for name in s.TABLES], ids=lambda table: table.name)
def test_each_colour_of_a_table_has_one_class(table):
    for colour, name in zip(table.colours, table.names, strict=True):
        assert table.name_of(table.tag_by_colour[colour]) == name


@pytest.mark.parametrize("table", s.CARLA_TABLES, ids=lambda table: table.name)
def test_colours_are_unique_in_each_table_of_carla(table):
    assert len(set(table.colours)) == len(table.names)
    assert table.tag_by_colour[(128, 64, 128)] == table.names.index("road")


@pytest.mark.parametrize(
    ("table", "classes", "tags"),
    [
        (s.CARLA_BEFORE_0_9_14, ["vehicle"], (10,)),
        (s.CARLA_FROM_0_9_14, ["vehicle"], (14, 15, 16, 17, 18, 19)),
        (s.CARLA_FROM_0_9_14, ["road", "road_line"], (1, 24)),
    ],
)
def test_the_tags_of_classes_and_of_a_group(table, classes, tags):
    assert table.tags_of(classes) == tuple(np.flatnonzero(table.lookup(classes) == 1)) == tags


@pytest.mark.parametrize("wrong", ["", "latest", "carla", "9" * 5000 + ".1"])
def test_an_invalid_version_raises(wrong):
    with pytest.raises(ConfigError, match=r"no tag table.*0\.9\.15.*cityscapes"):
        s.table_for_version(wrong)
    with pytest.raises(ConfigError, match="'motorway'"):
        s.CARLA_FROM_0_9_14.tags_of(["motorway"])


def test_labels_of_detectors():
    assert s.classes_of_label("Car") == ("vehicle",)
    assert s.classes_of_label("Traffic Light") == ("traffic_light", "traffic_sign")
    assert s.classes_of_label("Unicorn") is None


def test_a_tag_beyond_the_table_is_unlabeled():
    table = s.CARLA_FROM_0_9_14
    last = len(table.names) - 1
    found = [table.name_of(tag) for tag in (0, last, last + 1, 255)]
    assert found == ["unlabeled", table.names[last], "unlabeled", "unlabeled"]


def test_pixels_of_classes():
    tags = np.arange(24, dtype=np.uint8).reshape(4, 6)[:, ::2]
    table, classes = s.CARLA_BEFORE_0_9_14, ("road", "road_line")
    np.testing.assert_array_equal(mark(tags, table.lookup(classes)), np.isin(tags, table.tags_of(classes)))
