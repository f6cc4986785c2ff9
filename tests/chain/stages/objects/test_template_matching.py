"""A patch is found where it was cut out, and nowhere else."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.template import find_patch
from roadperc_stream.core.datatypes import Box

IMAGE = np.random.default_rng(0).integers(0, 256, (80, 120), dtype=np.uint8)
PATCH = IMAGE[30:42, 50:70]


def test_the_patch_where_it_was_cut_out():
    box, score = find_patch(IMAGE, PATCH, None, 0.9)
    assert box == Box(50, 30, 70, 42)
    assert score == pytest.approx(1.0)


def test_the_patch_inside_a_box_of_the_image():
    assert find_patch(IMAGE, PATCH, Box(45.2, 25, 80, 50), 0.9)[0] == Box(50, 30, 70, 42)
    assert find_patch(IMAGE, PATCH, Box(50, 30, 70, 42), 0.9)[0] == Box(50, 30, 70, 42)
    assert find_patch(IMAGE, PATCH, Box(51, 30, 90, 60), 0.9) is None


def test_a_box_beyond_the_image_is_clipped():
    assert find_patch(IMAGE, PATCH, Box(-50, -50, 500, 500), 0.9)[0] == Box(50, 30, 70, 42)


def test_brightness_and_contrast_do_not_matter():
    dimmer = (PATCH * 0.4 + 30).astype(np.uint8)
    box, score = find_patch(IMAGE, dimmer, None, 0.9)
    assert (box, score > 0.99) == (Box(50, 30, 70, 42), True)


def test_the_least_score_decides():
    other = np.random.default_rng(1).integers(0, 256, PATCH.shape, dtype=np.uint8)
    _, score = find_patch(IMAGE, other, None, -1.0)
    assert -1 < score < 0.6
    assert find_patch(IMAGE, other, None, 0.6) is None


@pytest.mark.parametrize("around", [Box(50, 30, 69, 42), Box(50, 30, 70, 41), Box(200, 30, 300, 60), Box(9, 9, 9, 9)])
def test_a_window_too_small(around):
    assert find_patch(IMAGE, PATCH, around, 0.0) is None


@pytest.mark.parametrize("patch", [np.full((9, 9), 7, np.uint8), np.empty((0, 5), np.uint8), np.uint8([[3]])])
def test_a_patch_that_shows_nothing(patch):
    assert find_patch(IMAGE, patch, None, -1.0) is None


def test_a_flat_image_looks_like_nothing():
    flat = np.full((80, 120), 200, np.uint8)
    assert find_patch(flat, PATCH, None, -1.0) is None
    flat[30:42, 50:70] = PATCH
    assert find_patch(flat, PATCH, None, 0.9)[0] == Box(50, 30, 70, 42)
