"""A template is found where it was cut out, and nowhere else."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.template import correlate
from roadperc_stream.model import Box

IMAGE = np.random.default_rng(0).integers(0, 256, (80, 120), dtype=np.uint8)
TEMPLATE = IMAGE[30:42, 50:70]
WHOLE = Box(0, 0, 120, 80)


def test_the_template_where_it_was_cut_out():
    box, score = correlate(IMAGE, TEMPLATE, WHOLE).match(0.9)
    assert box == Box(50, 30, 70, 42)
    assert score == pytest.approx(1.0)


def test_the_template_inside_a_box_of_the_image():
    assert correlate(IMAGE, TEMPLATE, Box(45.2, 25, 80, 50)).match(0.9)[0] == Box(50, 30, 70, 42)
    assert correlate(IMAGE, TEMPLATE, Box(50, 30, 70, 42)).match(0.9)[0] == Box(50, 30, 70, 42)
    assert correlate(IMAGE, TEMPLATE, Box(51, 30, 90, 60)).match(0.9) is None


def test_a_box_beyond_the_image_is_clipped():
    assert correlate(IMAGE, TEMPLATE, Box(-50, -50, 500, 500)).match(0.9)[0] == Box(50, 30, 70, 42)


def test_brightness_and_contrast_do_not_matter():
    dimmer = (TEMPLATE * 0.4 + 30).astype(np.uint8)
    box, score = correlate(IMAGE, dimmer, WHOLE).match(0.9)
    assert (box, score > 0.99) == (Box(50, 30, 70, 42), True)


def test_the_least_score_decides():
    other = np.random.default_rng(1).integers(0, 256, TEMPLATE.shape, dtype=np.uint8)
    _, score = correlate(IMAGE, other, WHOLE).match(-1.0)
    assert -1 < score < 0.6
    assert correlate(IMAGE, other, WHOLE).match(0.6) is None


@pytest.mark.parametrize("around", [Box(50, 30, 69, 42), Box(50, 30, 70, 41), Box(200, 30, 300, 60), Box(9, 9, 9, 9)])
def test_a_window_too_small(around):
    assert correlate(IMAGE, TEMPLATE, around) is None


@pytest.mark.parametrize("template", [np.full((9, 9), 7, np.uint8), np.empty((0, 5), np.uint8), np.uint8([[3]])])
def test_a_template_without_texture(template):
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
