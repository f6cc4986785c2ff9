"""Patches aligned: known answers, and the same bits by both forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.kernels.forms import SEEDS, assert_same_bits, both

UNSTRETCHED = np.eye(2)
IMAGES = arrays(np.uint8, st.tuples(st.integers(1, 20), st.integers(1, 20)))
NUMBERS = st.floats(-30, 30) | st.floats()


def waves(height, width, shift=(0.0, 0.0), offset=0.0):
    """Grey levels that do not repeat within a patch, moved right and down by a shift."""
    rows, columns = np.mgrid[:height, :width].astype(float)
    x, y = columns - shift[0], rows - shift[1]
    levels = 100 + 50 * np.sin(0.7 * x + 0.2 * y) + 50 * np.cos(0.6 * y - 0.3 * x)
    return np.rint(levels + offset).astype(np.uint8)


def asked(before, before_px, stretch, after, start, iterations=20, still_px=0.01):
    px, start = np.array(before_px, float), np.array(start, float)
    stretch = np.ascontiguousarray(np.broadcast_to(stretch, (len(start), 2, 2)))
    return before, px, stretch, after, start, iterations, still_px


def aligned(kernel, *patches):
    arguments = asked(*patches)
    return arguments[4], kernel.align_patches(*arguments)


@both("odometry")
@pytest.mark.parametrize("offset", [0, 40], ids=["same brightness", "brighter"])
def test_a_shift_is_found_to_a_fraction_of_a_pixel(kernel, offset):
    centres, after = np.array([(15.0, 15.0), (20.5, 17.25), (25.0, 24.0)]), waves(40, 40, (0.7, -0.4), offset)
    px, correlation = aligned(kernel, waves(40, 40), centres, UNSTRETCHED, after, centres)
    np.testing.assert_allclose(px - centres, [(0.7, -0.4)] * 3, atol=0.03)
    assert (correlation > 0.999).all()


@both("odometry")
def test_a_stretched_picture_is_found(kernel):
    rows, columns = np.mgrid[:60, :60]
    half = waves(60, 60)[rows // 2 + 15, columns // 2 + 15]  # pixel (30 + 2 a, 30 + 2 b) shows (30 + a, 30 + b)
    px, correlation = aligned(kernel, waves(60, 60), [(30.0, 30.0)], 2 * UNSTRETCHED, half, [(30.0, 30.0)])
    np.testing.assert_allclose(px, [(30.5, 30.5)], atol=0.6)
    assert correlation[0] > 0.98


@both("odometry")
def test_other_pictures_and_patches_without_texture_do_not_correlate(kernel):
    noise = np.random.default_rng(1).integers(0, 255, (40, 40), np.uint8)
    assert aligned(kernel, waves(40, 40), [(20.0, 20.0)], UNSTRETCHED, noise, [(20.0, 20.0)])[1][0] < 0.5
    flat = np.full((30, 30), 80, np.uint8)
    px, correlation = aligned(kernel, flat, [(15.0, 15.0)], UNSTRETCHED, flat, [(14.0, 15.5)])
    np.testing.assert_array_equal(px, [(14.0, 15.5)])
    assert correlation[0] == 0


@settings(max_examples=50)
@given(
    IMAGES,
    IMAGES,
    arrays(float, st.tuples(st.integers(0, 3), st.just(8)), elements=NUMBERS),
    st.integers(0, 4),
    st.floats(0, 1),
)
def test_any_patches_have_the_same_bits(before, after, numbers, iterations, still_px):
    stretch = numbers[:, 2:6].reshape(-1, 2, 2)
    asked_now = asked(before, numbers[:, :2], stretch, after, numbers[:, 6:], iterations, still_px)
    assert_same_bits("odometry", "align_patches", *asked_now)


@given(SEEDS)
def test_patches_inside_and_at_the_edges_of_an_image_have_the_same_bits(seed):
    rng = np.random.default_rng(seed)
    before, after = rng.integers(0, 256, (2, 40, 50), np.uint8)
    px, start = rng.uniform(-3, (53, 43), (2, 30, 2))
    px[::5], start[::3] = np.rint(px[::5]), np.rint(start[::3])
    stretch = UNSTRETCHED + rng.normal(0.0, rng.choice((0.0, 0.05, 0.8)), (30, 2, 2))
    assert_same_bits("odometry", "align_patches", *asked(before, px, stretch, after, start))
