"""Pixels of a class: known answers, and the compiled ones against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.core.kernels import class_masks_plain

compiled = pytest.importorskip("roadperc_stream.core.kernels.class_masks_compiled")
BOTH = pytest.mark.parametrize("kernel", [class_masks_plain, compiled], ids=["plain", "compiled"])


@BOTH
def test_pixels_of_a_class_are_marked(kernel):
    tags, marks = np.array([[0, 3, 7], [255, 3, 1]], np.uint8), np.full((2, 3), 9, np.uint8)
    kernel.mark_class(tags, np.isin(np.arange(256), (3, 255)).astype(np.uint8), marks)
    np.testing.assert_array_equal(marks, [[0, 1, 0], [1, 1, 0]])


@given(st.integers(0, 2**32 - 1), st.integers(0, 5), st.integers(0, 40), st.integers(0, 20))
def test_compiled_marks_are_the_same(seed, height, width, of_class):
    rng = np.random.default_rng(seed)
    tags, table = rng.integers(0, 32, (height, width), np.uint8), np.zeros(256, np.uint8)
    table[rng.choice(32, of_class, replace=False)] = 1
    found = np.full((2, height, width), 9, np.uint8)
    for kernel, marks in zip((class_masks_plain, compiled), found, strict=True):
        kernel.mark_class(tags, table, marks)
    np.testing.assert_array_equal(*found)


@BOTH
def test_what_does_not_fit_is_refused(kernel):
    tags, table = np.zeros((2, 3), np.uint8), np.zeros(256, np.uint8)
    for wrong in ((tags[1:], table, tags), (tags, table[1:], tags)):
        with pytest.raises(ValueError, match="expected one size"):
            kernel.mark_class(*wrong)
