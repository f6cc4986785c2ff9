"""Lines that the compiled PNG filters refuse; ``tests/formats/test_png.py`` compares the decoded pixels."""

import numpy as np
import pytest

png = pytest.importorskip("roadperc_stream.kernels.png_compiled")


@pytest.mark.parametrize("kind", [5, 255])
def test_an_unknown_filter_is_reported(kind):
    lines = np.array([[0, 1, 2, 3], [kind, 1, 2, 3]], np.uint8)
    assert not png.reverse_filters(lines.copy(), 3)
    assert not png.reverse_to_grey(lines, 3, np.empty((2, 1), np.uint8))
    assert png.reverse_filters(lines[:0], 3)


def test_lines_without_whole_pixels_and_other_arrays_are_refused():
    for columns, step in ((4, 2), (5, 3), (1, 1), (0, 1), (6, 5), (4, 0)):
        with pytest.raises(ValueError, match="expected whole pixels"):
            png.reverse_filters(np.zeros((2, columns), np.uint8), step)
    for lines in (np.zeros((2, 4), np.int8), np.zeros((2, 8), np.uint8)[:, ::2], np.zeros(4, np.uint8)):
        with pytest.raises((ValueError, TypeError)):
            png.reverse_filters(lines, 3)
    for shape in ((2, 2), (1, 1), (3, 1)):
        with pytest.raises(ValueError, match="to grey"):
            png.reverse_to_grey(np.zeros((2, 4), np.uint8), 3, np.empty(shape, np.uint8))
