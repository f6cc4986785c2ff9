"""One object belongs to one detection: the one it fits best."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.distance import Measured
from roadperc_stream.chain.stages.objects.filtering import choose
from roadperc_stream.chain.stages.objects.regions import Region
from roadperc_stream.model import Box

BOX = Box(10, 10, 30, 30)


def candidate(owner, fit, distance_m, box=BOX):
    distances = None if distance_m is None else np.full((1, 1), distance_m, np.float32)
    return Region(owner, box, fit, np.ones((1, 1), np.int32), np.array([False, True]), distances, None)


def measure(region):
    return Measured(None if region.distances_m is None else round(float(region.distances_m[0, 0]), 4), 0.1)


def chosen(labels, *candidates):
    return [c and (c.region.fit, c.measured.distance_m) for c in choose(labels, candidates, measure)]


def test_each_gets_what_fits_best():
    ours, theirs = [candidate(0, 0.9, 10.0), candidate(0, 0.5, 20.0)], [candidate(1, 0.8, 20.0)]
    assert chosen(["Car", "Car"], ours, theirs) == [(0.9, 10.0), (0.8, 20.0)]


def test_what_another_has_is_not_given_again():
    hidden = [candidate(1, 0.8, 10.1), candidate(1, 0.4, 25.0)]
    assert chosen(["Car", "Car"], [candidate(0, 0.9, 10.0)], hidden) == [(0.9, 10.0), (0.4, 25.0)]
    assert chosen(["Car", "Car"], [candidate(0, 0.9, 10.0)], hidden[:1]) == [(0.9, 10.0), None]


def test_what_is_elsewhere_or_at_another_distance_or_another_kind_is_another():
    first = [candidate(0, 0.9, 10.0)]
    assert chosen(["Car", "Car"], first, [candidate(1, 0.8, 10.0, Box(40, 10, 60, 30))])[1] is not None
    assert chosen(["Car", "Car"], first, [candidate(1, 0.8, 11.0)])[1] is not None
    assert chosen(["Car", "Pedestrian"], first, [candidate(1, 0.8, 10.0)])[1] is not None
    assert chosen(["Car", "Truck"], first, [candidate(1, 0.8, 10.0)])[1] is None


def test_without_distances_nothing_is_the_same():
    assert chosen(["Car", "Car"], [candidate(0, 0.9, None)], [candidate(1, 0.8, None)]) == [(0.9, None), (0.8, None)]


def test_nothing_to_choose_from():
    assert chosen([]) == []
    assert chosen(["Car"], []) == [None]


def test_what_is_not_looked_at_is_not_measured():
    """Distances are what costs the most."""
    measured = []
    choose(["Car"], [[candidate(0, 0.9, 10.0), candidate(0, 0.5, 20.0)]], lambda r: measured.append(r) or measure(r))
    assert [region.fit for region in measured] == [0.9]


@pytest.mark.parametrize(("expected_m", "chosen_m"), [(None, 16.5), (12.5, 12.6), (16.0, 16.5), (30.0, 16.5)])
def test_of_regions_that_fit_alike_the_one_where_the_object_is_expected_is_chosen(expected_m, chosen_m):
    regions = [candidate(0, 0.65, 16.5), candidate(0, 0.63, 12.6), candidate(0, 0.4, 30.0)]
    (found,) = choose(["Car"], [regions], measure, {0: expected_m})
    assert found.measured.distance_m == chosen_m
