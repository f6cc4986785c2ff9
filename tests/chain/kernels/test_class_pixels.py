"""Pixels of a class: by hand, and the compiled ones against OpenCV's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.kernels import class_pixels_plain as plain

WAYS = ("plain", "compiled")
CLASS = np.isin(np.arange(256), (3, 7)).astype(np.uint8)


def kernel(way):
    return pytest.importorskip(f"roadperc_stream.chain.kernels.class_pixels_{way}")


@pytest.mark.parametrize("way", WAYS)
def test_a_line_of_three_is_kept_a_pair_is_not(way):
    tags = np.zeros((7, 9), np.uint8)
    tags[2, 2:5], tags[5, 5:7] = 7, 3
    marked = np.full_like(tags, 9)
    kernel(way).mark_together(tags, CLASS, 3, marked)
    assert np.argwhere(marked).tolist() == [[2, 3]]
    assert marked.max() == 1
    assert kernel(way).count_of_class(tags, CLASS) == 5


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9), st.integers(0, 10))
def test_compiled_pixels_are_the_same(seed, height, width, least):
    compiled = kernel("compiled")
    tags = np.random.default_rng(seed).integers(1, 9, (2 * height, 3 * width), np.uint8)[::2, ::3]
    found, expected = np.full((2, *tags.shape), 9, np.uint8)
    compiled.mark_together(tags, CLASS, least, found)
    plain.mark_together(tags, CLASS, least, expected)
    np.testing.assert_array_equal(found, expected)
    assert compiled.count_of_class(tags, CLASS) == plain.count_of_class(tags, CLASS)


@given(st.integers(0, 2**32 - 1), st.integers(0, 90), st.integers(0, 200), st.integers(0, 256))
def test_both_ways_mark_the_pixels_of_a_class(seed, height, width, tags_of_class):
    rng = np.random.default_rng(seed)
    of_class = (rng.permutation(256) < tags_of_class).astype(np.uint8)
    tags = rng.integers(0, 256, (2 * height, 3 * width), np.uint8)[::2, ::3]
    for way in WAYS if tags.size else WAYS[1:]:  # OpenCV has no empty image
        marked = kernel(way).mark(tags, of_class)
        np.testing.assert_array_equal(marked, of_class[tags])
        assert marked.dtype == np.uint8


def test_what_does_not_fit_is_refused():
    tags = np.zeros((2, 3), np.uint8)
    for asked in ((tags, CLASS, 3, tags.T.copy()), (tags, CLASS[:9], 3, tags), (tags[:0], CLASS, 3, tags[:0])):
        with pytest.raises(ValueError, match="expected one size"):
            kernel("compiled").mark_together(*asked)
    for counting in ("count_of_class", "mark"):
        with pytest.raises(ValueError, match="expected 256"):
            getattr(kernel("compiled"), counting)(tags, CLASS[:9])
