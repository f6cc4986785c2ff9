"""Points of an object: by hand, and the compiled ones against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.kernels import objects_plain as plain

WAYS = ("plain", "compiled")
EGO_T_CAMERA = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]], np.float64)
WANTED = (np.arange(256) == 7).astype(np.uint8)


def kernel(way):
    return pytest.importorskip(f"roadperc_stream.chain.kernels.objects_{way}")


@pytest.mark.parametrize("way", WAYS)
def test_points_of_the_class_behind_a_distance(way):
    depth_m = np.full((5, 7), np.nan, np.float32)
    tags = np.zeros((5, 7), np.uint8)
    depth_m[1:4:2, 1:6:2] = [[3, 4, np.nan], [3, 3, 9]]
    tags[1:4:2, 1:6:2] = [[7, 7, 7], [7, 0, 7]]
    camera, straight = (4.0, 2.0, 1.0, 1.0), (0.5, 1.0, 0.0, 0.0)
    asked = depth_m, camera, (1, 1, 6, 4, 2), (tags, WANTED), 3.0, (-0.5, 3.0)
    points, ranges_m = kernel(way).object_points(*asked)
    assert points.tolist() == [[0, 0, 3], [2, 0, 4], [0, 3, 3]]
    assert ranges_m.tolist() == [3.0, np.sqrt(20), np.sqrt(18)]
    assert kernel(way).left_of(points, EGO_T_CAMERA, straight).tolist() == [-0.5, -2.5, -0.5]
    assert kernel(way).mean_direction(points, ranges_m, 4.5) == (0.5 / 3, 1 / 3)
    assert np.isnan(kernel(way).mean_direction(points, ranges_m, 1.0)).all()
    assert len(kernel(way).object_points(*asked[:3], None, *asked[4:])[0]) == 4
    nothing = kernel(way).object_points(*asked[:2], (6, 1, 3, 4, 2), *asked[3:])
    assert [found.shape for found in nothing] == [(0, 3), (0,)]


@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 20),
    st.integers(0, 20),
    st.integers(1, 3),
    st.booleans(),
    st.floats(0, 60),
)
def test_compiled_points_have_the_same_bits(seed, height, width, step, of_any, distance_m):
    compiled = kernel("compiled")
    rng = np.random.default_rng(seed)
    depth_m = rng.uniform(0.5, 60, (height, width)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.1] = np.nan
    tags = rng.integers(6, 9, (2 * height, 3 * width), np.uint8)[::2, ::3]
    (x0, x1), (y0, y1) = np.sort(rng.integers(0, width + 1, 2)).tolist(), rng.integers(0, height + 1, 2).tolist()
    camera, circle = tuple(rng.uniform(1, 30, 4).tolist()), tuple(rng.normal(size=4).tolist())
    of_class = None if of_any else (tags, WANTED)
    ego_T_camera = rng.normal(size=(4, 4)).T
    asked = depth_m, camera, (x0, y0, x1, y1, step), of_class, distance_m, (-3.0, 9.0)
    found, expected = (
        (*seen, way.left_of(seen[0], ego_T_camera, circle))
        for way in (compiled, plain)
        for seen in [way.object_points(*asked)]
    )
    for ours, theirs in zip(found, expected, strict=True):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape)
        np.testing.assert_array_equal(ours, theirs)
    ours, theirs = (way.mean_direction(*expected[:2], distance_m) for way in (compiled, plain))
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("way", WAYS)
def test_a_mean_of_negative_zeros_is_zero(way):
    direction = kernel(way).mean_direction(np.array([[-0.0, -0.0, 1.0]]), np.ones(1), 2.0)
    assert not np.signbit(direction).any()


@pytest.mark.parametrize("way", WAYS)
def test_what_does_not_fit_is_refused(way):
    depth_m, tags = np.zeros((2, 3), np.float32), np.zeros((2, 3), np.uint8)
    for box, of_class in (
        ((0, 0, 4, 2, 1), None),
        ((0, 0, 3, 3, 1), None),
        ((-1, 0, 3, 2, 1), None),
        ((0, -1, 3, 2, 1), None),
        ((0, 0, 3, 2, 0), None),
        ((0, 0, 3, 2, 1), (tags.T, WANTED)),
        ((0, 0, 3, 2, 1), (tags, WANTED[:9])),
    ):
        asked = depth_m, (1.0,) * 4, box, of_class, 3.0, (0.0, 1.0)
        with pytest.raises(ValueError, match="do not fit"):
            kernel(way).object_points(*asked)
    with pytest.raises(ValueError, match="points of"):
        kernel(way).mean_direction(np.zeros((2, 3)), np.zeros(3), 1.0)
    for shape, other in (((2, 3), (3, 4)), ((2, 2), (4, 4))):
        with pytest.raises(ValueError, match="expected"):
            kernel(way).left_of(np.zeros(shape), np.zeros(other), (0.0,) * 4)
