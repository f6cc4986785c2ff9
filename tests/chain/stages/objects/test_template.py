"""A template is found only where it was cut out; an obstacle is searched for by its picture."""

import numpy as np
import pytest

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages.objects.template import LABEL, correlate, cut, find_obstacle, picture, png_of
from roadperc_stream.chain.stages.objects.tracker import ObjectsState, step
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.model import Absent, Box
from tests.chain.stages.objects.frames import CAMERA, texture
from tests.scenes import scene_of

IMAGE = np.random.default_rng(0).integers(0, 256, (80, 120), dtype=np.uint8)
TEMPLATE = IMAGE[30:42, 50:70]
WHOLE, PLACE = Box(0, 0, 120, 80), Box(50, 30, 70, 42)


@pytest.mark.parametrize("around", [WHOLE, PLACE, Box(45.2, 25, 80, 50), Box(-50, -50, 500, 500)])
def test_the_template_is_found_where_it_was_cut_out(around):
    box, score = correlate(IMAGE, TEMPLATE, around).match(0.9)
    assert (box, score) == (PLACE, pytest.approx(1.0))
    assert correlate(IMAGE, TEMPLATE, Box(51, 30, 90, 60)).match(0.9) is None


@pytest.mark.parametrize(
    ("box", "off_px", "shape"),
    [
        (Box(-10.0, 20.0, 30.0, 50.5), (5.0, 0.25), (31, 30)),  # beyond the image's border
        (Box(10.25, 20.0, 110.0, 50.0), (-0.125, 0.0), (30, 96)),  # longer than a template
    ],
)
def test_a_template_is_the_middle_of_its_box(box, off_px, shape):
    made = cut(IMAGE, box, 12.0)
    assert (made.off_px, made.grey.shape) == (off_px, shape)
    assert made.sides_px == (box.x_max - box.x_min, box.y_max - box.y_min)


def test_a_window_too_small_or_a_template_without_texture_gives_no_correlation():
    for around in (Box(50, 30, 69, 42), Box(50, 30, 70, 41), Box(200, 30, 300, 60), Box(9, 9, 9, 9)):
        assert correlate(IMAGE, TEMPLATE, around) is None
    for template in (np.full((9, 9), 7, np.uint8), np.empty((0, 5), np.uint8), np.uint8([[3]])):
        assert correlate(IMAGE, template, WHOLE) is None


def test_a_flat_image_matches_nothing():
    flat = np.full((80, 120), 200, np.uint8)
    assert correlate(flat, TEMPLATE, WHOLE).match(-1.0) is None
    flat[30:42, 50:70] = TEMPLATE
    assert correlate(flat, TEMPLATE, WHOLE).match(0.9)[0] == Box(50, 30, 70, 42)


def test_the_score_at_the_peak_is_that_of_the_definition():
    rng = np.random.default_rng(3)
    image = rng.integers(0, 256, (90, 120), np.uint8)
    template = (image[40:60, 30:70] * 0.5 + rng.integers(0, 90, (20, 40))).astype(np.uint8)
    found = correlate(image, template, Box(0, 0, 120, 90))
    expected = np.corrcoef(image[40:60, 30:70].ravel(), template.ravel())[0, 1]
    box_px, score = found.peak
    assert (box_px.x_min, box_px.y_min) == (30, 40)
    assert score == np.float32(expected)


def test_brightness_and_contrast_do_not_count():
    image = np.random.default_rng(4).integers(0, 120, (300, 400), np.uint8)
    _, score = correlate(image, 2 * image[100:180, 200:290] + 7, Box(0, 0, 400, 300)).peak
    assert score == 1.0


def cfg_of(grey, **settings):
    return ObjectsConfig(template_png=png_of(grey), **settings)


def test_a_picture_is_the_same_pixels_in_base_64():
    grey = texture()[:20, :30]
    assert (picture(png_of(grey)) == grey).all()
    assert picture("iVBORw0KGgo=") is None


def test_an_obstacle_is_found_after_any_displacement():
    image = texture()
    scene = scene_of(CAMERA, grey=np.roll(image, (7, -31), (0, 1)))
    item, correlation = find_obstacle(cfg_of(image[60:95, 40:90]), scene)
    assert item.detection.box_px == Box(9.0, 67.0, 59.0, 102.0)
    assert (item.detection.label, item.kept, item.distance_m) == (LABEL, True, None)
    assert item.detection.score == pytest.approx(1.0, abs=1e-5)
    assert correlation.peak[0] == item.detection.box_px


def test_a_low_correlation_is_not_an_obstacle():
    cfg = cfg_of(texture(seed=1)[60:95, 40:90])
    item, correlation = find_obstacle(cfg, scene_of(CAMERA, grey=texture()))
    assert item is None
    assert correlation.peak[1] < cfg.template_min_score
    assert find_obstacle(cfg, scene_of(CAMERA)) == (None, None)
    assert find_obstacle(ObjectsConfig(), scene_of(CAMERA, grey=texture())) == (None, None)


def test_the_obstacles_distance_is_along_the_ray_or_the_axis():
    camera = g.Camera("camera", 320, 240, 200.0, 200.0, 159.5, 119.5)
    depth_m = np.full(camera.size, 20.0, np.float32)
    depth_m[62, 41] = 12.0
    image = texture()
    scene = scene_of(camera, grey=image, depth_m=depth_m)
    ray, depth, low = (
        find_obstacle(cfg_of(image[60:95, 40:90], **settings), scene)[0].distance_m
        for settings in (
            {"distance_quantile": 0},
            {"distance_quantile": 0, "template_distance": "depth"},
            {"template_distance": "depth"},
        )
    )
    assert (depth, low) == (12.0, 20.0)
    assert ray == pytest.approx(12.0 * np.sqrt(1 + (118.5 / 200) ** 2 + (57.5 / 200) ** 2))


@pytest.mark.parametrize("template_distance", ["ray", "depth"])
def test_an_obstacle_beyond_the_depths_range_has_no_distance(template_distance):
    image = texture()
    limit_m = 65.535
    depth_m = np.full(image.shape, limit_m, np.float32)
    scene = scene_of(CAMERA, grey=image, depth_m=depth_m, limit_m=limit_m)
    item, _ = find_obstacle(cfg_of(image[60:95, 40:90], template_distance=template_distance), scene)
    assert (item.distance_m, item.beyond_range) == (None, True)


def test_an_obstacle_is_an_object_without_detections():
    image = texture()
    scene = scene_of(CAMERA, grey=image)
    _, out = step(cfg_of(image[60:95, 40:90]), ObjectsState(), scene)
    assert [item.detection.box_px for item in out.objects] == [Box(40.0, 60.0, 90.0, 95.0)]
    assert len(out.searches) == 1
    assert isinstance(step(ObjectsConfig(), ObjectsState(), scene)[1], Absent)
