"""Smoothed distances of a region: by hand, and the compiled ones against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.kernels import objects_plain

WAYS = ("plain", "compiled")


def of_way(way):
    return pytest.importorskip(f"roadperc_stream.chain.kernels.objects_{way}").region_distances


@pytest.mark.parametrize("way", WAYS)
def test_each_is_the_mean_of_the_known_ones_around_it(way):
    labels, of_region = np.int32([[1, 1, 1, 3], [2, 3, 3, 0]]), np.array([0, 1, 0, 1], bool)
    distances = np.float32([[1, 2, np.nan, np.inf], [100, 6, 9, 100]])
    near, noise = of_way(way)(labels, of_region, distances, np.float32([[1, 2, 3, 4], [5, 6, 7, 8]]))
    assert near.tolist() == [3.0, 4.5, np.inf, 4.5, np.float32(17 / 3)]
    assert noise.tolist() == [1.0, 2.0, 6.0, 7.0]


@given(st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(0, 9))
def test_compiled_distances_have_the_same_bits(seed, height, width):
    compiled = of_way("compiled")
    rng = np.random.default_rng(seed)
    distances = rng.lognormal(3.0, 2.0, (2, 2 * height, 2 * width)).astype(np.float32)
    distances[0][rng.random(distances.shape[1:]) < 0.2] = np.nan
    distances[0][rng.random(distances.shape[1:]) < 0.2] = np.inf
    labels = rng.integers(0, 9, (2 * height, 2 * width), np.int32)[::2, ::2]
    asked = labels, rng.random(9) < 0.8, distances[0, ::2, ::2], distances[1, ::2, ::2]
    for found, expected in zip(compiled(*asked), objects_plain.region_distances(*asked), strict=True):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("way", WAYS)
def test_other_sizes_are_refused(way):
    sizes = [(2, 3), (2, 3), (2, 3)]
    for k in range(len(sizes)):
        other = [*sizes[:k], (3, 2), *sizes[k + 1 :]]
        labels, distances, noise = (np.zeros(size, np.float32) for size in other)
        with pytest.raises(ValueError, match="pixels"):
            of_way(way)(labels.astype(np.int32), np.zeros(1, bool), distances, noise)
