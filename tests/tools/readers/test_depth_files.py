import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera
from roadperc_stream.tools.readers.depth_files import (
    GREY_ENCODINGS,
    carla_metres,
    depth_encoding,
    depth_metres,
    grey_encoding,
)
from roadperc_stream.tools.readers.pixel_files import load_pixels
from tests.analytic import Road
from tests.tools.dump_writer import HEIGHT, WIDTH, alpha, camera_pixels, carla_codes, depth_m, jpeg, npy, png

CODINGS = {
    "linear": lambda metres: metres / 1000.0,
    "linear-50": lambda metres: np.minimum(metres / 50.0, 1.0),
    "logarithmic": lambda metres: 1.0 + np.log(metres / 1000.0) / 5.70378,
}


def log_grey(metres):
    return np.rint(CODINGS["logarithmic"](metres) * 255.0).clip(0, 255).astype(np.uint8)


def csv(path, values):
    np.savetxt(path, values, delimiter=", ")
    return path


EXACT = {"rtol": 1e-6, "atol": 5e-5}
LOSSY = {"rtol": 0.0113}
"""Half a step of the 255 grey levels."""
MAKERS = {
    "carla bgr": (lambda p: png(p, carla_codes(depth_m())), "carla 24 bit", EXACT),
    "carla bgra": (lambda p: png(p, alpha(carla_codes(depth_m()))), "carla 24 bit", EXACT),
    "raw bgra npy": (lambda p: npy(p, alpha(carla_codes(depth_m()))), "carla 24 bit", EXACT),
    "float npy": (lambda p: npy(p, depth_m()), "metres", EXACT),
    "float32 npy with a channel": (lambda p: npy(p, depth_m().astype(np.float32)[..., None]), "metres", EXACT),
    "course csv": (lambda p: csv(p, depth_m() / 1000.0), "metres / 1000", EXACT),
    "csv in metres": (lambda p: csv(p, depth_m()), "metres", EXACT),
    "log grey": (lambda p: png(p, log_grey(depth_m())), "logarithmic grey", LOSSY),
    "log rgb": (lambda p: png(p, np.dstack([log_grey(depth_m())] * 3)), "logarithmic grey", LOSSY),
}


@pytest.mark.parametrize("name", MAKERS)
def test_every_encoding_gives_the_known_metres(tmp_path, name):
    make, encoding, tolerance = MAKERS[name]
    path = make(tmp_path / "000000.png")
    assert depth_encoding([path]) == encoding
    found = depth_metres(load_pixels(path), encoding)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, depth_m(), **tolerance)


NUMBERS_16 = np.array([[0, 1500], [65535, 256]], np.uint16)


@pytest.mark.parametrize(
    ("coding", "expected"),
    [
        ("mm", [[np.nan, 1.5], [65.535, 0.256]]),
        ("cm", [[np.nan, 15.0], [655.35, 2.56]]),
        ("m", [[np.nan, 1500.0], [65535.0, 256.0]]),
        ("depth-256", [[np.nan, 1500 / 256], [65535 / 256, 1.0]]),
        ("tum", [[np.nan, 0.3], [65535 / 5000, 0.0512]]),
        ("disparity", [[np.nan, 360 * 256 / 1500], [360 * 256 / 65535, 360.0]]),
    ],
)
@pytest.mark.parametrize("write", [png, lambda p, values: npy(p, values.astype(float))], ids=["png", "npy"])
def test_the_users_coding_of_numbers(tmp_path, write, coding, expected):
    """Disparity of a camera with fx 720 and a baseline of 0.5 m: depth = fx * baseline / disparity."""
    path = write(tmp_path / "0.png", NUMBERS_16)
    encoding = depth_encoding([path], coding)
    np.testing.assert_allclose(depth_metres(load_pixels(path), encoding, 720 * 0.5), expected, rtol=1e-6)


def test_an_unknown_unit_and_a_wrong_coding_are_errors_that_name_the_option(tmp_path):
    far = npy(tmp_path / "0.npy", np.array([[0.0, 1200.0, 45000.0, np.inf]]))
    with pytest.raises(DumpError, match=r"0\.npy: the median is 23100: pass --depth-coding mm"):
        depth_encoding([far])
    codes = png(tmp_path / "1.png", carla_codes(depth_m()))
    with pytest.raises(DumpError, match=r"1\.png: depth is encoded as carla 24 bit, but --depth-coding cm is for numb"):
        depth_encoding([codes], "cm")


@given(st.integers(0, 2**24 - 1))
def test_24_bits_as_carla_documents_them(code):
    r, g, b = code & 255, code >> 8 & 255, code >> 16
    found = carla_metres(np.array([[[b, g, r]]], np.uint8))[0, 0]
    expected = (r + g * 256 + b * 65536) / (2**24 - 1) * 1000
    assert np.isnan(found) if code == 0 else abs(found - expected) <= 1e-6 * expected


def test_the_first_unambiguous_file_decides(tmp_path):
    sky = png(tmp_path / "0.png", np.full((HEIGHT, WIDTH, 3), 255, np.uint8))
    black = png(tmp_path / "1.png", np.zeros((2, 2, 3), np.uint8))
    codes = png(tmp_path / "2.png", carla_codes(depth_m()))
    grey = png(tmp_path / "3.png", log_grey(depth_m()))
    assert depth_encoding([sky, codes, grey]) == depth_encoding([black, codes, grey]) == "carla 24 bit"
    assert depth_encoding([sky, grey]) == depth_encoding([grey, black, codes]) == "logarithmic grey"
    for encoding in ("carla 24 bit", "logarithmic grey"):
        np.testing.assert_allclose(depth_metres(load_pixels(sky), encoding), 1000.0)


def test_grey_of_a_palette_is_its_colour_not_its_index(tmp_path):
    indices = np.array([[0, 1], [2, 3]], np.uint8)
    image = Image.fromarray(indices, "P")
    image.putpalette([255, 255, 255, 10, 10, 10, 100, 100, 100, 0, 0, 0])
    image.save(tmp_path / "0.png")
    assert depth_encoding([tmp_path / "0.png"]) == "logarithmic grey"
    found = depth_metres(load_pixels(tmp_path / "0.png"), "logarithmic grey")
    expected = 1000.0 * np.exp((np.array([[255, 10], [100, 0]]) / 255.0 - 1.0) * 5.70378)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def palette_png(path):
    image = Image.fromarray(np.zeros((2, 2), np.uint8), "L").convert("L")
    image.putpalette([128, 64, 128] * 256)
    image.save(path)
    return path


@pytest.mark.parametrize(
    "make",
    [
        lambda p: jpeg(p, camera_pixels()),
        palette_png,
        lambda p: npy(p, np.zeros((2, 2, 3))),
        lambda p: png(p, np.zeros((2, 2, 3), np.uint16)),
    ],
    ids=["jpeg of 24 bits", "palette", "three floats", "16-bit colour"],
)
def test_other_content_than_depth_is_refused(tmp_path, make):
    path = make(tmp_path / "000003.png")
    with pytest.raises(DumpError, match=r"000003\.png"):
        depth_encoding([path])


def test_a_file_with_another_encoding_is_named(tmp_path):
    path = png(tmp_path / "5.png", log_grey(depth_m()))
    with pytest.raises(
        DumpError, match=r"5\.png: depth is encoded as logarithmic grey, the files before as carla 24 bit"
    ):
        depth_metres(load_pixels(path), "carla 24 bit")


def grey(path, coding, road, rounded=np.rint):
    """Write a camera's view of a road, and return its true depth."""
    depth_m = np.nan_to_num(road.depth_m(), nan=1000.0).clip(0.1, 1000.0)
    levels = 255.0 * CODINGS[coding](depth_m)
    return png(path, rounded(levels).clip(0, 255).astype(np.uint8)), depth_m


@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize(
    ("road", "rounded"),
    [
        (Road(width=320, height=240), np.rint),
        (Road(width=320, height=240), np.floor),
        (Road(width=320, height=240, height_m=2.4, pitch=0.06), np.rint),
        (Road(pitch=-0.04), np.rint),
    ],
    ids=["level", "cut off", "high and down", "up"],
)
def test_the_ground_shows_the_coding(tmp_path, coding, road, rounded):
    path, depth_m = grey(tmp_path / "0.png", coding, road, rounded)
    found, why = grey_encoding([path], road.camera, None)
    assert found == GREY_ENCODINGS[coding]
    assert f"8-bit depth is {found}; errors of a level ground in grey levels: {coding} " in why
    metres = depth_metres(load_pixels(path), found)
    near = (depth_m > 5.0) & (depth_m < 45.0) & np.isfinite(metres)
    assert near.any()
    assert np.median(np.abs(metres[near] - depth_m[near])) < (2.0 if coding == "linear" else 0.3)


@pytest.mark.parametrize(
    "values",
    [
        np.full((240, 320), 90, np.uint8),
        np.random.default_rng(0).integers(1, 255, (240, 320)).astype(np.uint8),
        np.tile(np.linspace(0, 200, 240).astype(np.uint8)[:, None], (1, 320)),
    ],
    ids=["a wall", "noise", "upside down"],
)
def test_images_without_ground_are_an_error_that_names_the_option(tmp_path, values):
    path = png(tmp_path / "0.png", values)
    assert depth_encoding([path]) == "logarithmic grey"
    with pytest.raises(
        DumpError, match=r"the coding of 8-bit grey depth is unknown \(.*\); pass --depth-coding linear"
    ):
        grey_encoding([path], Camera("camera", 320, 240, 160.0, 160.0, 159.5, 119.5), None)


def test_16_bit_millimetres(tmp_path):
    millimetres = np.array([[0, 1, 1500], [65535, 40000, 7]], np.uint16)
    path = png(tmp_path / "0.png", millimetres)
    assert depth_encoding([path]) == "millimetres"
    np.testing.assert_allclose(
        depth_metres(load_pixels(path), "millimetres"), [[np.nan, 0.001, 1.5], [65.535, 40.0, 0.007]], rtol=1e-6
    )


def test_a_cut_off_depth_is_unknown(tmp_path):
    path = png(tmp_path / "0.png", np.array([[0, 51, 255]], np.uint8))
    np.testing.assert_allclose(depth_metres(load_pixels(path), "linear grey to 50 m"), [[np.nan, 10.0, np.nan]])
    np.testing.assert_allclose(depth_metres(load_pixels(path), "linear grey to 1000 m"), [[np.nan, 200.0, 1000.0]])


def test_millimetres_of_larger_integers_need_no_option(tmp_path):
    path = npy(tmp_path / "0.npy", np.array([[0, 70_000]], np.int32))
    assert depth_encoding([path]) == "millimetres"
    np.testing.assert_allclose(depth_metres(load_pixels(path), "millimetres"), [[np.nan, 70.0]], rtol=1e-6)


def test_ambiguous_files_get_the_encoding_of_their_type(tmp_path):
    """Black PNGs and zeros in .npy have no known depth in any encoding."""
    empty = [npy(tmp_path / f"{k}.npy", np.zeros((2, 2))) for k in range(2)]
    black = [png(tmp_path / f"{k}.png", np.zeros((2, 2, 3), np.uint8)) for k in range(2)]
    assert depth_encoding(empty) == "metres"
    assert depth_encoding(black) == "carla 24 bit"
    assert np.isnan(depth_metres(load_pixels(black[0]), "carla 24 bit")).all()


@pytest.mark.parametrize("metres", [1.0, 1.001])
def test_one_is_the_far_plane_and_beyond_it_are_metres(tmp_path, metres):
    path = npy(tmp_path / "0.npy", np.array([[0.0, 0.2, metres]]))
    assert depth_encoding([path]) == ("metres / 1000" if metres == 1.0 else "metres")


def test_unknown_numbers_are_not_a_number(tmp_path):
    path = npy(tmp_path / "0.npy", np.array([[np.nan, 0.0, -1.0, 5.0]]))
    np.testing.assert_array_equal(depth_metres(load_pixels(path), "metres"), [[np.nan, np.nan, np.nan, 5.0]])


def test_a_near_frame_in_metres_keeps_the_encoding(tmp_path):
    near = npy(tmp_path / "0.npy", np.full((2, 2), 0.8))
    far = npy(tmp_path / "1.npy", np.full((2, 2), 8.0))
    assert depth_encoding([near, far]) == "metres"
    np.testing.assert_allclose(depth_metres(load_pixels(near), "metres"), 0.8, rtol=1e-6)


@pytest.mark.parametrize("asked", CODINGS)
def test_the_chosen_coding_is_used(tmp_path, asked):
    road = Road(width=320, height=240)
    path, _ = grey(tmp_path / "0.png", "logarithmic", road)
    found, why = grey_encoding([path], road.camera, asked)
    assert (found, why.endswith(f"--depth-coding {asked}")) == (GREY_ENCODINGS[asked], True)
