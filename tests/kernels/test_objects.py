"""Regions, their distances and points: known answers, and the same bits by both forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.kernels import objects_plain as plain

compiled = pytest.importorskip("roadperc_stream.kernels.objects_compiled")
BOTH = pytest.mark.parametrize("kernel", [plain, compiled], ids=["plain", "compiled"])
JUMPS = np.array((0.02, 0.04, 0.08), np.float32)


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 12), st.floats(0, 1), st.integers(1, 3))
def test_compiled_regions_are_the_same(seed, height, width, share, ways):
    rng = np.random.default_rng(seed)
    of_class = (rng.random((height, width)) < share).astype(np.uint8)
    depths = np.append(np.arange(0.0, 0.2, 0.013), np.nan).astype(np.float32)
    log_depth = rng.choice(depths, (height, width))
    asked = log_depth, of_class, JUMPS[:ways]
    for found, expected in zip(compiled.divided(*asked), plain.divided(*asked), strict=True):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)


def test_regions_of_a_staircase():
    log_depth = np.float32([[0.0, 0.01, 0.04, 1.0, 1.07, 9.0]])
    for kernel in (plain, compiled):
        labels, names, ways, bounds, pixels = kernel.divided(log_depth, np.uint8([[1, 1, 1, 1, 1, 0]]), JUMPS)
        assert labels.tolist() == [[1, 1, 2, 3, 4, 0]]
        assert names.tolist() == [[0, 1, 2, 3, 4], [0, 5, 5, 0, 0], [0, 0, 0, 6, 6]]
        assert (ways.tolist(), pixels.tolist()) == ([0, 0, 0, 0, 1, 2], [2, 1, 1, 1, 3, 2])
        assert bounds[[0, 2]].tolist() == [[0, 2, 3, 4, 0, 3], [2, 3, 4, 5, 3, 5]]


@BOTH
def test_a_distance_is_the_mean_of_the_known_ones_around_it(kernel):
    labels, of_region = np.int32([[1, 1, 1, 3], [2, 3, 3, 0]]), np.array([0, 1, 0, 1], bool)
    distances = np.float32([[1, 2, np.nan, np.inf], [100, 6, 9, 100]])
    near, noise = kernel.region_distances(labels, of_region, distances, np.float32([[1, 2, 3, 4], [5, 6, 7, 8]]))
    assert near.tolist() == [3.0, 4.5, np.inf, 4.5, np.float32(17 / 3)]
    assert noise.tolist() == [1.0, 2.0, 6.0, 7.0]


@given(st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(0, 9))
def test_compiled_distances_have_the_same_bits(seed, height, width):
    rng = np.random.default_rng(seed)
    distances = rng.lognormal(3.0, 2.0, (2, 2 * height, 2 * width)).astype(np.float32)
    distances[0][rng.random(distances.shape[1:]) < 0.2] = np.nan
    distances[0][rng.random(distances.shape[1:]) < 0.2] = np.inf
    labels = rng.integers(0, 9, (2 * height, 2 * width), np.int32)[::2, ::2]
    asked = labels, rng.random(9) < 0.8, distances[0, ::2, ::2], distances[1, ::2, ::2]
    for found, expected in zip(compiled.region_distances(*asked), plain.region_distances(*asked), strict=True):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)


WANTED = (np.arange(256) == 7).astype(np.uint8)


@BOTH
def test_points_of_the_class_behind_a_distance(kernel):
    depth_m = np.full((5, 7), np.nan, np.float32)
    tags = np.zeros((5, 7), np.uint8)
    depth_m[1:4:2, 1:6:2] = [[3, 4, np.nan], [3, 3, 9]]
    tags[1:4:2, 1:6:2] = [[7, 7, 7], [7, 0, 7]]
    asked = depth_m, (4.0, 2.0, 1.0, 1.0), (1, 1, 6, 4, 2), (tags, WANTED), 3.0, (-0.5, 3.0)
    points, ranges_m = kernel.object_points(*asked)
    assert points.tolist() == [[0, 0, 3], [2, 0, 4], [0, 3, 3]]
    assert ranges_m.tolist() == [3.0, np.sqrt(20), np.sqrt(18)]
    assert len(kernel.object_points(*asked[:3], None, *asked[4:])[0]) == 4
    nothing = kernel.object_points(*asked[:2], (6, 1, 3, 4, 2), *asked[3:])
    assert [found.shape for found in nothing] == [(0, 3), (0,)]


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.booleans(), st.floats(0, 60))
def test_compiled_points_have_the_same_bits(seed, step, of_any, distance_m):
    rng = np.random.default_rng(seed)
    height, width = rng.integers(0, 21, 2).tolist()
    depth_m = rng.uniform(0.5, 60, (height, width)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.1] = np.nan
    tags = rng.integers(6, 9, (2 * height, 3 * width), np.uint8)[::2, ::3]
    (x0, x1), (y0, y1) = np.sort(rng.integers(0, width + 1, 2)).tolist(), rng.integers(0, height + 1, 2).tolist()
    camera = tuple(rng.uniform(1, 30, 4).tolist())
    of_class = None if of_any else (tags, WANTED)
    asked = depth_m, camera, (x0, y0, x1, y1, step), of_class, distance_m, (-3.0, 9.0)
    for ours, theirs in zip(compiled.object_points(*asked), plain.object_points(*asked), strict=True):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape)
        np.testing.assert_array_equal(ours, theirs)


def test_sizes_that_do_not_fit_are_refused():
    for depths, pixels, jumps in (((2, 3), (3, 2), 3), ((0, 3), (0, 3), 3), ((2, 3), (2, 3), 0)):
        with pytest.raises(ValueError, match=f"{jumps} jumps"):
            compiled.divided(np.zeros(depths, np.float32), np.zeros(pixels, np.uint8), JUMPS[:jumps])
    for wrong in range(3):
        labels, distances, noise = (np.zeros((3, 2) if k == wrong else (2, 3), np.float32) for k in range(3))
        with pytest.raises(ValueError, match="pixels"):
            compiled.region_distances(labels.astype(np.int32), np.zeros(1, bool), distances, noise)
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
            compiled.object_points(*asked)
