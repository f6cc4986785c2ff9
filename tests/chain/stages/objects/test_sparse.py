"""A lidar's few points in a box: those of the object apart from those of a nearer one."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.distance import own_distances

NAN = np.nan


def box_of(*groups):
    """(30, 60) distances, NaN but for points of (distance, rows, columns), each 1 % deeper at its far end."""
    distances = np.full((30, 60), NAN, np.float32)
    for distance_m, rows, columns in groups:
        u, v = np.meshgrid(columns, rows)
        distances[v, u] = distance_m * np.linspace(1.0, 1.01, u.size).reshape(u.shape)
    return distances


WHOLE = (12.6, range(3, 28, 6), range(2, 58, 2))
CORNER = (8.0, range(15, 28, 6), range(0, 12, 2))


def test_a_nearer_car_in_a_corner_of_the_box_is_another_one():
    assert own_distances(box_of(WHOLE, CORNER)).min() == pytest.approx(12.6)


def test_a_single_object_has_all_points_and_what_is_in_steps_is_one():
    assert len(own_distances(box_of(WHOLE))) == np.isfinite(box_of(WHOLE)).sum()
    long = [(10.0 * 1.05**k, range(3, 28, 6), range(6 * k, 6 * k + 6, 2)) for k in range(10)]
    assert own_distances(box_of(*long)).min() == pytest.approx(10.0)


def test_two_points_are_no_object_unless_there_are_no_others():
    few = (5.0, (2, 29), (0, 59))
    assert own_distances(box_of((5.0, (2,), (0, 59)), CORNER)).min() == pytest.approx(8.0)
    assert len(own_distances(box_of((5.0, (2,), (0, 59))))) == 2
    assert own_distances(box_of(few, CORNER)).min() == pytest.approx(5.0)
    assert own_distances(np.full((4, 5), NAN, np.float32)).shape == (0,)
    assert own_distances(np.full((0, 5), NAN, np.float32)).shape == (0,)
