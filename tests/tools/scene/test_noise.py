import numpy as np
import pytest

from roadperc_stream.tools.scene.noise import GAIN, _wobbled, exposed, exposure_at, noisy_depth, noisy_tags


def stripes():
    tags = np.ones((480, 640), np.uint8)
    tags[:, 300:330] = 24
    tags[:100] = 11
    return tags


def test_blobs_cover_about_their_share_and_no_class_is_new():
    noisy = [noisy_tags(stripes(), 0.05, np.random.default_rng(i)) for i in range(8)]
    assert 0.02 < np.mean([np.mean(tags != stripes()) for tags in noisy]) < 0.08
    assert set(np.unique(noisy)) <= {1, 11, 24}


def test_depth_noise_is_relative_and_spares_the_sky():
    depth = np.full((200, 300), 20.0, np.float32)
    depth[:50] = 1000.0
    noisy = noisy_depth(depth, 0.01, np.random.default_rng(0))
    assert (noisy[:50] == 1000).all()
    assert noisy[50:].std() == pytest.approx(0.2, rel=0.03)
    assert noisy[50:].mean() == pytest.approx(20.0, abs=0.01)


def test_exposures_change_every_second_or_frame_and_end_in_black():
    def gains(kind):
        return [exposure_at(kind, k / 10, k, 5)[0] for k in range(20)]

    assert [len(set(gains(kind))) for kind in ("steps", "frames", "blackouts")] == [2, 20, 2]
    assert all(GAIN[0] <= gain <= GAIN[1] for kind in ("steps", "frames") for gain in gains(kind))
    assert gains("blackouts") == [1.0] * 18 + [0.0] * 2
    grey = np.array([[0, 100, 200]], np.uint8)
    np.testing.assert_array_equal(exposed(grey, 1.5, -10.0), [[0, 140, 255]])


def test_the_displacement_is_smooth_with_the_given_deviation():
    """Tags that are their own column or row show the displacement; 16 px per cell, 3 px deviation."""
    columns, rows = np.meshgrid(np.arange(240), np.arange(240))
    right, down = (
        (_wobbled(places.astype(np.uint8), 3.0, 16.0, np.random.default_rng(0)) - places)[20:-20, 20:-20]
        for places in (columns, rows)
    )
    for displacement in (right, down):
        assert displacement.std() == pytest.approx(3.0, rel=0.1)
        assert np.abs(displacement.mean()) < 0.6
        neighbours = [np.abs(np.diff(displacement, axis=axis)) for axis in (0, 1)]
        assert max(step.mean() for step in neighbours) < 0.5
        apart = [displacement[:, :-32] * displacement[:, 32:], displacement[:-32] * displacement[32:]]
        assert max(product.mean() for product in apart) < 0.3 * 9.0
    assert abs(np.corrcoef(right.ravel(), down.ravel())[0, 1]) < 0.3
