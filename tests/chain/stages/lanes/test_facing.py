"""Edges that face the ego lane, on small images."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.stages.lanes.observe import facing_edges


def test_facing_edges_look_towards_the_ego_lane():
    separators = np.zeros((4, 20), np.uint8)
    separators[:, 4:7] = separators[:, 15:] = 1
    road = np.ones((6, 20), bool)
    left = facing_edges(separators, road, "left", 2)
    right = facing_edges(separators, road, "right", 2)
    np.testing.assert_array_equal(left, [[6.5, row] for row in (2, 3, 4, 5)])
    assert set(right[:, 0]) == {3.5, 14.5}


def test_edges_towards_no_road_do_not_count():
    separators = np.zeros((4, 20), np.uint8)
    separators[:, 4:7] = 1
    assert len(facing_edges(separators, np.zeros((4, 20), bool), "left", 0)) == 0


@pytest.mark.parametrize(("fringe_px", "found"), [(0, True), (1, True), (4, True), (5, False)])
def test_edges_face_each_other_across_a_fringe_of_foreign_pixels(fringe_px, found):
    separators = np.zeros((4, 40), np.uint8)
    separators[:, 10:14] = 1
    road = np.ones((4, 40), bool)
    road[:, 10 - fringe_px : 14 + fringe_px] = False
    for side, middle in (("left", 13.5 + fringe_px / 2), ("right", 9.5 - fringe_px / 2)):
        edges = facing_edges(separators, road, side, 0)
        assert set(edges[:, 0]) == ({middle} if found else set())


@given(st.integers(0, 2**32 - 1))
def test_a_mirrored_image_has_the_mirrored_edges_in_the_same_order(seed):
    rng = np.random.default_rng(seed)
    separators = (rng.random((6, 30)) < 0.3).astype(np.uint8)
    road = rng.random((8, 30)) < 0.5
    left = facing_edges(separators, road, "left", 2)
    mirrored = facing_edges(separators[:, ::-1], road[:, ::-1], "right", 2)
    np.testing.assert_array_equal(mirrored, left * (-1, 1) + (29, 0))
    assert (np.diff(left[:, 1]) >= 0).all()
