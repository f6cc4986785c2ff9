"""Tag tables against CARLA's documentation."""

import numpy as np
import pytest

from roadperc_stream.errors import ConfigError
from roadperc_stream.model import tag_tables as s


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
    ],
)
def test_tags_of_datasets(name, tags):
    table = s.table_for_version(name)
    assert {known: set(table.tags_of([known])) for known in tags} == tags


@pytest.mark.parametrize("table", s.TABLES.values(), ids=lambda table: table.name)
def test_each_colour_of_a_table_has_one_class(table):
    for colour, name in zip(table.colours, table.names, strict=True):
        assert table.name_of(table.tag_by_colour()[colour]) == name


@pytest.mark.parametrize("table", s.CARLA_TABLES, ids=lambda table: table.name)
def test_colours_are_unique_in_each_table_of_carla(table):
    assert len(set(table.colours)) == len(table.names)
    assert table.tag_by_colour()[(128, 64, 128)] == table.names.index("road")


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
    with pytest.raises(ConfigError, match=r"0\.9\.15"):
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
