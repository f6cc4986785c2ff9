"""8-bit grey depth: its coding is told by the ground, or asked for, and never guessed."""

import numpy as np
import pytest

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera
from roadperc_stream.tools.carla_dump.depth_files import ENCODINGS, depth_encoding, depth_metres, grey_encoding
from roadperc_stream.tools.carla_dump.pixel_files import load_pixels
from tests.analytic import Road
from tests.tools.dump_writer import png

CODINGS = {
    "linear": lambda metres: metres / 1000.0,
    "linear-50": lambda metres: np.minimum(metres / 50.0, 1.0),
    "logarithmic": lambda metres: 1.0 + np.log(metres / 1000.0) / 5.70378,
}


def grey(path, coding, road, floor=False):
    """A file of what a camera sees of a road, and how deep it truly is."""
    depth_m = np.nan_to_num(road.depth_m(), nan=1000.0).clip(0.1, 1000.0)
    levels = 255.0 * CODINGS[coding](depth_m)
    return png(path, (np.floor(levels) if floor else np.rint(levels)).clip(0, 255).astype(np.uint8)), depth_m


@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize(
    "road",
    [Road(width=320, height=240), Road(width=320, height=240, height_m=2.4, pitch=0.06), Road(pitch=-0.04)],
    ids=["level", "high and down", "up"],
)
def test_the_ground_tells_the_coding(tmp_path, coding, road):
    path, depth_m = grey(tmp_path / "0.png", coding, road)
    found, why = grey_encoding([path], road.camera, None)
    assert found == ENCODINGS[coding]
    assert f"8-bit depth is {found}: greys of a level ground are off as {coding} by " in why
    metres = depth_metres(load_pixels(path), found)
    near = (depth_m > 5.0) & (depth_m < 45.0) & np.isfinite(metres)
    assert near.any()
    assert np.median(np.abs(metres[near] - depth_m[near])) < (2.0 if coding == "linear" else 0.3)


@pytest.mark.parametrize("coding", CODINGS)
def test_it_is_told_where_greys_are_cut_off_too(tmp_path, coding):
    road = Road(width=320, height=240)
    path, _ = grey(tmp_path / "0.png", coding, road, floor=True)
    assert grey_encoding([path], road.camera, None)[0] == ENCODINGS[coding]


@pytest.mark.parametrize("asked", CODINGS)
def test_what_is_asked_for_is_taken(tmp_path, asked):
    road = Road(width=320, height=240)
    path, _ = grey(tmp_path / "0.png", "logarithmic", road)
    found, why = grey_encoding([path], road.camera, asked)
    assert (found, why.endswith(f"--grey-depth {asked}")) == (ENCODINGS[asked], True)


@pytest.mark.parametrize(
    "values",
    [
        np.full((240, 320), 90, np.uint8),
        np.random.default_rng(0).integers(1, 255, (240, 320)).astype(np.uint8),
        np.tile(np.linspace(0, 200, 240).astype(np.uint8)[:, None], (1, 320)),
    ],
    ids=["a wall", "noise", "upside down"],
)
def test_what_shows_no_ground_is_an_error_that_names_the_option(tmp_path, values):
    path = png(tmp_path / "0.png", values)
    assert depth_encoding([path]) == "logarithmic grey"
    with pytest.raises(
        DumpError, match=r"8-bit grey depth, and nothing tells its coding \(.*\): say --grey-depth linear"
    ):
        grey_encoding([path], Camera("camera", 320, 240, 160.0, 160.0, 159.5, 119.5), None)


def test_a_cut_off_depth_is_unknown(tmp_path):
    path = png(tmp_path / "0.png", np.array([[0, 51, 255]], np.uint8))
    np.testing.assert_allclose(depth_metres(load_pixels(path), "linear grey to 50 m"), [[np.nan, 10.0, np.nan]])
    np.testing.assert_allclose(depth_metres(load_pixels(path), "linear grey to 1000 m"), [[np.nan, 200.0, 1000.0]])
