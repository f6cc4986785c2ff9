"""The check of the arrays that frozen dataclasses hold."""

import numpy as np
import pytest

from roadperc_stream.geometry.arrays import read_only


@pytest.mark.parametrize(
    "array",
    [np.zeros((2, 3), np.float32), np.zeros((3, 2)), np.zeros(3)],
    ids=["another dtype", "another length", "another number of axes"],
)
def test_an_array_of_another_type_or_shape_is_refused(array):
    with pytest.raises(ValueError, match=r"points: expected float64 \(None, 3\), got"):
        read_only(array, np.float64, (None, 3), "points")


def test_a_fitting_array_can_no_longer_be_written():
    points = read_only(np.zeros((2, 3)), np.float64, (None, 3), "points")
    with pytest.raises(ValueError, match="read-only"):
        points[0, 0] = 1.0
