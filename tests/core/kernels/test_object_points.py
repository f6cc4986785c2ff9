"""Points of an object: by hand, and the compiled ones against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.core.kernels import object_points_plain as plain

WAYS = ("plain", "compiled")
WANTED = (np.arange(256) == 7).astype(np.uint8)


def kernel(way):
    return pytest.importorskip(f"roadperc_stream.core.kernels.object_points_{way}")


@pytest.mark.parametrize("way", WAYS)
def test_points_of_the_class_behind_a_distance(way):
    depth_m = np.float32([[3, 4, np.nan], [3, 3, 9]])
    x, y = np.array([0.0, 0.75, 1.0]), np.array([0.0, 1.0])
    tags = np.uint8([[7, 7, 7], [7, 0, 7]])
    points, ranges_m = kernel(way).object_points(depth_m, x, y, (tags, WANTED), 3.0, (-0.5, 3.0))
    assert points.tolist() == [[0, 0, 3], [3, 0, 4], [0, 3, 3]]
    assert ranges_m.tolist() == [3.0, 5.0, np.sqrt(18)]
    assert kernel(way).mean_direction(points, ranges_m, 5.0) == (0.25, 1 / 3)
    assert np.isnan(kernel(way).mean_direction(points, ranges_m, 1.0)).all()
    assert len(kernel(way).object_points(depth_m, x, y, None, 3.0, (-0.5, 3.0))[0]) == 4


@given(st.integers(0, 2**32 - 1), st.integers(0, 20), st.integers(0, 20), st.booleans(), st.floats(0, 60))
def test_compiled_points_have_the_same_bits(seed, height, width, of_any, distance_m):
    compiled = kernel("compiled")
    rng = np.random.default_rng(seed)
    depth_m = rng.uniform(0.5, 60, (2 * height, 3 * width)).astype(np.float32)[::2, ::3]
    depth_m[rng.random(depth_m.shape) < 0.1] = np.nan
    tags = rng.integers(6, 9, (2 * height, 3 * width), np.uint8)[::2, ::3]
    rays = rng.normal(size=width), rng.normal(size=height)
    asked = depth_m, *rays, None if of_any else (tags, WANTED), distance_m, (-3.0, 9.0)
    found, expected = compiled.object_points(*asked), plain.object_points(*asked)
    for ours, theirs in zip(found, expected, strict=True):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape)
        np.testing.assert_array_equal(ours, theirs)
    ours, theirs = (way.mean_direction(*expected, distance_m) for way in (compiled, plain))
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("way", WAYS)
def test_a_mean_of_negative_zeros_is_zero(way):
    direction = kernel(way).mean_direction(np.array([[-0.0, -0.0, 1.0]]), np.ones(1), 2.0)
    assert not np.signbit(direction).any()


@pytest.mark.parametrize("way", WAYS)
def test_what_does_not_fit_is_refused(way):
    depth_m, x, y, tags = np.zeros((2, 3), np.float32), np.zeros(3), np.zeros(2), np.zeros((2, 3), np.uint8)
    for asked in (
        (depth_m, y, x, None),
        (depth_m, x, y, (tags.T, WANTED)),
        (depth_m, x, y, (tags, WANTED[:9])),
    ):
        with pytest.raises(ValueError, match="do not fit"):
            kernel(way).object_points(*asked, 3.0, (0.0, 1.0))
    with pytest.raises(ValueError, match="points of"):
        kernel(way).mean_direction(np.zeros((2, 3)), np.zeros(3), 1.0)
