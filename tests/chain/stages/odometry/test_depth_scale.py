"""The error that the depths of one image share, from ratios of depths."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.odometry.depth_scale import DepthScale, shared_square

WIDTH = 640


def square_of(common, region_std=0.0, noise_std=0.0, points=400, seed=7):
    """The shared square of points all over the image; regions of 80 pixels have their own error."""
    rng = np.random.default_rng(seed)
    px = rng.uniform(0, (WIDTH, 480), (points, 2)).astype(np.float32)
    regions = rng.normal(0, region_std, (6, 8))
    column, row = (px // 80).astype(int).T
    ratios = common + regions[row, column] + rng.normal(0, noise_std, points)
    return shared_square(ratios, px, WIDTH, np.ones(points))


def test_exact_depths_have_no_shared_error():
    assert square_of(0.0) == 0


def test_a_common_ratio_is_shared_by_two_images():
    assert square_of(0.02, noise_std=0.001) == pytest.approx(0.02**2 / 2, rel=0.05)


def test_noise_of_single_points_averages_out():
    squares = [square_of(0.0, noise_std=0.05, seed=seed) for seed in range(30)]
    assert abs(np.mean(squares)) < 0.003**2


def test_errors_of_regions_average_out_over_the_cells():
    squares = [square_of(0.0, region_std=0.03, seed=seed) for seed in range(30)]
    assert 0.5 < np.sqrt(np.mean(squares)) / (0.03 / np.sqrt(48)) < 2


def test_too_few_points_show_nothing():
    assert square_of(0.1, points=12) is None


def test_few_frames_count_with_a_larger_variance():
    assert DepthScale(1e-4, 1).variance == pytest.approx(3e-4)
    assert DepthScale(1e-4, 20).variance == pytest.approx(1.1e-4)
    assert DepthScale(-1e-6, 20).variance == 0
