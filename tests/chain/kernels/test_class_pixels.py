"""Pixels of a class: a known answer, and the same bits by the plain and the compiled functions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.kernels import class_pixels_plain as plain

compiled = pytest.importorskip("roadperc_stream.chain.kernels.class_pixels_compiled")
CLASS = np.isin(np.arange(256), (3, 7)).astype(np.uint8)


@pytest.mark.parametrize("kernel", [plain, compiled], ids=["plain", "compiled"])
def test_three_pixels_in_a_row_are_kept_two_are_not(kernel):
    tags = np.zeros((7, 9), np.uint8)
    tags[2, 2:5], tags[5, 5:7] = 7, 3
    marked = np.full_like(tags, 9)
    kernel.mark_together(tags, CLASS, 3, marked)
    assert np.argwhere(marked).tolist() == [[2, 3]]
    assert marked.max() == 1


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9), st.integers(0, 10))
def test_mark_together_gives_the_same_pixels(seed, height, width, least):
    tags = np.random.default_rng(seed).integers(1, 9, (2 * height, 3 * width), np.uint8)[::2, ::3]
    found, expected = np.full((2, *tags.shape), 9, np.uint8)
    compiled.mark_together(tags, CLASS, least, found)
    plain.mark_together(tags, CLASS, least, expected)
    np.testing.assert_array_equal(found, expected)


@given(st.integers(0, 2**32 - 1), st.integers(0, 90), st.integers(0, 200), st.integers(0, 256))
def test_mark_finds_the_pixels_of_a_class(seed, height, width, tags_of_class):
    rng = np.random.default_rng(seed)
    of_class = (rng.permutation(256) < tags_of_class).astype(np.uint8)
    tags = rng.integers(0, 256, (2 * height, 3 * width), np.uint8)[::2, ::3]
    for kernel in (plain, compiled) if tags.size else (compiled,):  # OpenCV has no empty image
        np.testing.assert_array_equal(kernel.mark(tags, of_class), of_class[tags], strict=True)


def test_sizes_that_do_not_fit_are_refused():
    tags = np.zeros((2, 3), np.uint8)
    for wrong in ((tags, CLASS, 3, tags.T.copy()), (tags, CLASS[:9], 3, tags), (tags[:0], CLASS, 3, tags[:0])):
        with pytest.raises(ValueError, match="expected one size"):
            compiled.mark_together(*wrong)
    with pytest.raises(ValueError, match="expected 256"):
        compiled.mark(tags, CLASS[:9])
