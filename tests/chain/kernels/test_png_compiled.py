"""The compiled filters of PNG against the specification's own words, a byte at a time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

png = pytest.importorskip("roadperc_stream.chain.kernels.png_compiled")


@st.composite
def filtered(draw, fewest_bytes=1):
    """(H, 1 + W pixel_bytes) lines whose first bytes name any filter, and the bytes of a pixel."""
    step = draw(st.integers(fewest_bytes, 4))
    height, width = draw(st.integers(1, 6)), draw(st.integers(1, 9))
    lines = draw(arrays(np.uint8, (height, 1 + width * step)))
    lines[:, 0] = draw(arrays(np.uint8, height, elements=st.integers(0, 4)))
    return lines, step


def by_the_specification(lines, step):
    """ISO/IEC 15948, table 9.1."""
    height, length = lines.shape[0], lines.shape[1] - 1
    rows = [[0] * (step + length)]
    for y in range(height):
        row, above = [0] * (step + length), rows[-1]
        for x in range(step, step + length):
            predicted = prediction(int(lines[y, 0]), row[x - step], above[x], above[x - step])
            row[x] = (int(lines[y, 1 + x - step]) + predicted) % 256
        rows.append(row)
    return np.array(rows, np.uint8)[1:, step:]


def prediction(kind, left, above, corner):
    return (0, left, above, (left + above) // 2, paeth(left, above, corner))[kind]


def paeth(left, above, corner):
    estimate = left + above - corner
    return min((left, above, corner), key=lambda neighbour: abs(estimate - neighbour))


@given(filtered())
def test_filters_are_reversed_as_specified(case):
    lines, step = case
    expected = by_the_specification(lines, step)
    assert png.reverse_filters(lines, step)
    np.testing.assert_array_equal(lines[:, 1:], expected)


@given(filtered(fewest_bytes=3))
def test_grey_is_that_of_the_reversed_pixels(case):
    lines, step = case
    red, green, blue = np.moveaxis(by_the_specification(lines, step).reshape(len(lines), -1, step), 2, 0)[:3].astype(
        int
    )
    grey = np.empty(red.shape, np.uint8)
    assert png.reverse_to_grey(lines, step, grey)
    np.testing.assert_array_equal(grey, (9797 * red + 19234 * green + 3737 * blue) >> 15)


@pytest.mark.parametrize("kind", [5, 255])
def test_an_unknown_filter_is_reported(kind):
    lines = np.array([[0, 1, 2, 3], [kind, 1, 2, 3]], np.uint8)
    assert not png.reverse_filters(lines.copy(), 3)
    assert not png.reverse_to_grey(lines, 3, np.empty((2, 1), np.uint8))


def test_no_lines_are_no_error():
    assert png.reverse_filters(np.empty((0, 4), np.uint8), 3)


@pytest.mark.parametrize(("columns", "step"), [(4, 2), (5, 3), (1, 1), (0, 1), (6, 5), (4, 0)])
def test_lines_without_whole_pixels_are_refused(columns, step):
    with pytest.raises(ValueError, match="expected whole pixels"):
        png.reverse_filters(np.zeros((2, columns), np.uint8), step)


@pytest.mark.parametrize("shape", [(2, 2), (1, 1), (3, 1)])
def test_a_grey_image_of_another_size_is_refused(shape):
    with pytest.raises(ValueError, match="to grey"):
        png.reverse_to_grey(np.zeros((2, 4), np.uint8), 3, np.empty(shape, np.uint8))


@pytest.mark.parametrize(
    "lines", [np.zeros((2, 4), np.int8), np.zeros((2, 8), np.uint8)[:, ::2], np.zeros(4, np.uint8)]
)
def test_other_arrays_are_refused(lines):
    with pytest.raises((ValueError, TypeError)):
        png.reverse_filters(lines, 3)
