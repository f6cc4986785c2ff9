"""Edges towards the road: by hand, and both ways alike."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

WAYS = ("plain", "compiled")


def facing_edges(way, *asked):
    return pytest.importorskip(f"roadperc_stream.core.kernels.facing_edges_{way}").facing_edges(*asked)


@pytest.mark.parametrize("way", WAYS)
def test_of_a_row_every_edge_that_has_road_beside_it(way):
    marked = np.zeros((2, 40), np.uint8)
    marked[1, [5, 6, 20, 30]] = 1
    road = np.ones_like(marked)
    road[1, 7:10] = road[1, 18:29] = 0
    assert facing_edges(way, marked, road, 1, 3).tolist() == [[8.0, 1.0], [30.5, 1.0]]
    assert facing_edges(way, marked, road, -1, 3).tolist() == [[29.5, 1.0], [18.5, 1.0], [4.5, 1.0]]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("shape", [(0, 5), (3, 0), (3, 1)])
def test_where_no_pixel_has_a_neighbour_there_is_no_edge(way, shape):
    ones = np.ones(shape, np.uint8)
    for towards in (1, -1):
        assert facing_edges(way, ones, ones, towards, 4).shape == (0, 2)


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 5),
    st.integers(1, 60),
    st.floats(0.0, 1.0),
    st.sampled_from((1, -1)),
    st.integers(0, 5),
)
def test_both_ways_give_the_same_edges(seed, height, width, share, towards, fringe):
    rng = np.random.default_rng(seed)
    runs = rng.random((height, width)) < share
    marked = np.repeat(runs, 3, axis=1)[:, ::2].astype(np.uint8)
    road = (rng.random(marked.shape) < share).astype(np.uint8)
    ours, theirs = (facing_edges(way, marked, road, towards, fringe) for way in WAYS)
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("way", WAYS)
def test_images_of_other_sizes_are_refused(way):
    image = np.zeros((2, 3), np.uint8)
    with pytest.raises(ValueError, match="expected one size"):
        facing_edges(way, image, image[:1], 1, 4)
