import numpy as np
import pytest

from roadperc_stream.tools.scene.spoil import noisy_depth, noisy_rgb, noisy_tags


def stripes():
    tags = np.ones((480, 640), np.uint8)
    tags[:, 300:330] = 24
    tags[:100] = 11
    return tags


def test_blobs_cover_about_their_share_and_borders_wobble():
    tags = stripes()
    shares = [np.mean(noisy_tags(tags, 0.05, np.random.default_rng(i)) != tags) for i in range(8)]
    assert 0.02 < np.mean(shares) < 0.08


def test_borders_wobble_smoothly_by_a_pixel_or_two():
    tags = stripes().repeat(2, axis=0).repeat(2, axis=1)
    noisy = [noisy_tags(tags, 0.02, np.random.default_rng(i)) for i in range(6)]
    left = [np.argmax(picture[300:] == 24, axis=1) for picture in noisy]
    moved = np.abs(np.array(left) - 600.0)
    middle = np.median(moved)
    assert 0.5 <= middle <= 3
    jumps = np.abs(np.diff(np.array(left), axis=1))
    assert np.median(jumps) == 0


def test_no_class_appears_that_was_not_there():
    assert set(np.unique(noisy_tags(stripes(), 0.1, np.random.default_rng(1)))) <= {1, 11, 24}


def test_depth_noise_is_relative_and_spares_the_sky():
    depth = np.full((200, 300), 20.0, np.float32)
    depth[:50] = 1000.0
    noisy = noisy_depth(depth, 0.01, np.random.default_rng(0))
    assert (noisy[:50] == 1000).all()
    assert noisy[50:].std() == pytest.approx(0.2, rel=0.03)
    assert noisy[50:].mean() == pytest.approx(20.0, abs=0.01)


def test_rgb_noise_has_its_deviation():
    grey = np.full((200, 300, 3), 120, np.uint8)
    assert noisy_rgb(grey, 4.0, np.random.default_rng(0)).std() == pytest.approx(4.0, rel=0.05)
