"""How much of lines lies on a mask: pixel by pixel, and both ways alike."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

WAYS = ("plain", "compiled")


def line_shares(way, *asked):
    return pytest.importorskip(f"roadperc_stream.core.kernels.line_shares_{way}").line_shares(*asked)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("margin", [0, 1, 3])
def test_a_lines_share_is_that_of_its_pixels(way, margin):
    rng = np.random.default_rng(0)
    mask = (rng.random((60, 80)) < 0.5 / (1 + 2 * margin) ** 2).astype(np.uint8)
    lines = np.concatenate((rng.integers(0, 60, (50, 4)), [[7, 7, 7, 7]])).astype(float)
    widened = cv2.dilate(mask, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
    for line, share in zip(lines, line_shares(way, lines, mask, margin), strict=True):
        x1, y1, x2, y2 = line
        count = int(max(abs(x2 - x1), abs(y2 - y1))) + 1
        along = (np.rint(np.linspace(*ends, count)).astype(int) for ends in ((y1, y2), (x1, x2)))
        assert share == widened[tuple(along)].mean()


@given(st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(1, 40), st.integers(1, 40), st.integers(0, 4))
def test_both_ways_have_the_same_shares(seed, count, height, width, margin):
    rng = np.random.default_rng(seed)
    mask = (rng.random((2 * height, width)) < 0.1).astype(np.uint8)[::2]
    lines = rng.uniform(0, 1, (count, 4)) * (width - 1, height - 1, width - 1, height - 1)
    lines = np.where(rng.random(lines.shape) < 0.7, np.rint(lines), lines)
    ours, theirs = (line_shares(way, lines, mask, margin) for way in WAYS)
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("outside", [-1.0, 3.5, np.nan, np.inf])
def test_lines_out_of_the_image_are_refused(way, outside):
    for place in range(4):
        line = np.zeros((1, 4))
        line[0, place] = outside
        with pytest.raises(ValueError, match="expected lines in an image of 4x4"):
            line_shares(way, line, np.ones((4, 4), np.uint8), 1)
