"""Regions of several jumps are those that dividing the pixels anew for each jump gives."""

import numpy as np
from scipy.ndimage import label

from roadperc_stream.chain.stages.objects.mosaic import Mosaic
from roadperc_stream.chain.stages.objects.regions import JUMPS, divide


def mosaic_of(of_class, log_depth):
    ends = np.array([0, len(of_class)])
    steps = np.ones((1, 2), int)
    return Mosaic(steps - 1, steps, ends, of_class, log_depth, None, None, None)


def connected(of_class, log_depth, jump):
    """The sets of pixels, by a flood fill over a grid of pixels and of what is between them."""
    height, width = of_class.shape
    grid = np.zeros((2 * height - 1, 2 * width - 1), bool)
    grid[::2, ::2] = of_class
    grid[::2, 1::2] = of_class[:, 1:] & of_class[:, :-1] & (np.abs(np.diff(log_depth, axis=1)) < jump)
    grid[1::2, ::2] = of_class[1:] & of_class[:-1] & (np.abs(np.diff(log_depth, axis=0)) < jump)
    labels, count = label(grid)
    return {frozenset(map(tuple, np.argwhere(labels[::2, ::2] == k + 1).tolist())) for k in range(count)}


def regions_of(division):
    for k in range(len(division.pixels)):
        of_region, (rows, columns) = division.of_region(k)
        mask = of_region[division.labels[rows, columns]]
        assert mask.any(axis=0)[[0, -1]].all()
        assert mask.any(axis=1)[[0, -1]].all()
        assert mask.sum() == division.pixels[k]
        yield frozenset(map(tuple, (np.argwhere(mask) + np.array((rows.start, columns.start))).tolist()))


def test_each_region_of_each_jump_once():
    rng = np.random.default_rng(0)
    for _ in range(20):
        of_class = (rng.random((24, 17)) < 0.7).astype(np.uint8)
        log_depth = rng.choice(np.arange(0.0, 0.2, 0.013), of_class.shape).astype(np.float32)
        division = divide(mosaic_of(of_class, log_depth))
        found = list(regions_of(division))
        expected = [connected(of_class, log_depth, jump) for jump in JUMPS]
        assert len(set(found)) == len(found)
        assert set(found) == set.union(*expected)
        assert {r for r, way in zip(found, division.ways, strict=True) if way == 0} == expected[0]


def test_no_pixels_of_the_class():
    division = divide(mosaic_of(np.zeros((5, 4), np.uint8), np.zeros((5, 4), np.float32)))
    assert (division.bounds.shape, division.pixels.shape) == ((4, 0), (0,))
