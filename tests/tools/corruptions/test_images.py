"""Known answers of the image corruptions: formulas of ImageNet-C on images where the result follows by hand."""

import numpy as np
import pytest

from roadperc_stream.tools.corruptions.draw import Draw
from roadperc_stream.tools.corruptions.images import IMAGES, plasma
from roadperc_stream.tools.corruptions.levels import LEVELS

BLACK = np.zeros((40, 60, 3), np.uint8)
GREY = np.full((200, 300, 3), 100, np.uint8)


def draw(name, **changes):
    return Draw(**{"seed": 1, "name": name, "stamp_ns": 5, "role": "image", "share": 0.5, "cameras": ()} | changes)


def corrupted(pixels, name, severity, **changes):
    return IMAGES[name](pixels, LEVELS[name][severity - 1], draw(name, **changes))


def test_every_image_corruption_has_levels_and_keeps_shape_and_type():
    for name in IMAGES:
        for severity in (1, 5):
            found = corrupted(BLACK + 30, name, severity)
            assert (found.shape, found.dtype) == (BLACK.shape, np.uint8), name
    assert all(len(levels) == 5 for levels in LEVELS.values())


def test_gaussian_noise_has_the_published_deviation():
    for severity in range(1, 6):
        values = corrupted(GREY + 28, "gaussian_noise", severity) / 255
        inside = np.abs(values - 128 / 255) < 0.4
        assert values[inside].std() == pytest.approx(min(LEVELS["gaussian_noise"][severity - 1], 0.22), rel=0.15)


def test_shot_noise_has_the_variance_of_photons():
    values = corrupted(GREY, "shot_noise", 1) / 255
    assert values.mean() == pytest.approx(100 / 255, abs=0.01)
    assert values.var() == pytest.approx(100 / 255 / 60, rel=0.05)


def test_impulse_noise_makes_half_of_the_share_black_and_half_white():
    found = corrupted(GREY, "impulse_noise", 5)
    assert (found == 0).mean() == pytest.approx(0.135, abs=0.005)
    assert (found == 255).mean() == pytest.approx(0.135, abs=0.005)
    assert set(np.unique(found)) == {0, 100, 255}


def test_defocus_spreads_a_point_over_the_disk():
    pixels = np.zeros((41, 41, 3), np.uint8)
    pixels[20, 20] = 255
    found = corrupted(pixels, "defocus_blur", 1)[..., 0]
    reach = np.arange(-20, 21)
    disk = reach**2 + reach[:, None] ** 2 <= 9
    assert disk.sum() == 29
    assert np.array_equal(found > 0, disk)
    assert set(found[disk]) == {int(255 / 29)}


def test_motion_blur_keeps_the_brightness_along_a_trail_of_falling_weights():
    pixels = np.zeros((101, 101, 3), np.uint8)
    pixels[50, 50] = 255
    found = corrupted(pixels, "motion_blur", 3)[..., 0]
    weights = np.exp(-(np.arange(31) ** 2) / (2 * 8**2))
    assert sorted(found[found > 0], reverse=True) == list(filter(None, (255 * weights / weights.sum()).astype(int)))
    assert found.max() == found[50, 50]
    assert np.array_equal(corrupted(GREY, "motion_blur", 3), GREY) or (corrupted(GREY, "motion_blur", 3) >= 99).all()


def test_brightness_adds_to_the_value_and_keeps_the_hue():
    pixels = np.array([[[50, 100, 200], [0, 0, 0], [250, 250, 250]]], np.uint8)
    (colour, black, white) = corrupted(pixels, "brightness", 1)[0]
    assert np.abs(colour.astype(float) - np.array([50, 100, 200]) * (200 + 25.5) / 200).max() < 1
    assert set(black) == {25}
    assert set(white) == {255}


def test_contrast_scales_the_difference_from_the_mean():
    pixels = np.concatenate((BLACK, BLACK + 200))
    found = corrupted(pixels, "contrast", 3)
    assert np.abs(np.unique(found).astype(float) - (80, 120)).max() <= 1


def test_fog_is_scaled_back_to_the_brightest_value():
    dark, white = corrupted(BLACK + 60, "fog", 1), corrupted(GREY * 0 + 255, "fog", 1)
    assert dark.max() <= 60
    assert int(255 / 2.5) <= white.min() < 130  # 1 / (1 + density) where the pattern is 0
    assert white.max() > 200


def test_plasma_is_smooth_and_spans_0_to_1():
    heights = plasma(64, 2.0, np.random.default_rng(0))
    assert (heights.min(), heights.max()) == (0, 1)
    assert np.abs(np.diff(heights, axis=0)).mean() < 0.5 * np.abs(heights - np.roll(heights, 32, 0)).mean()


def test_low_light_is_dark_and_noisy():
    ramp = np.tile(np.linspace(0, 255, 256).astype(np.uint8)[None, :, None], (50, 1, 3))
    found = corrupted(ramp, "low_light", 1).mean(axis=(0, 2)) / 255
    assert found[255] == pytest.approx(0.6, abs=0.02)
    assert found[128] == pytest.approx(0.6 * (128 / 255) ** 2, abs=0.02)
    assert found[0] < 0.01


def test_a_crash_covers_its_share_of_the_log_once():
    shares = np.linspace(0, 1, 201)
    black = np.array([not corrupted(GREY, "camera_crash", 3, share=share).any() for share in shares])
    assert black.mean() == pytest.approx(0.3, abs=0.01)
    assert np.abs(np.diff(black.astype(int))).sum() <= 2


def test_numbers_depend_on_seed_stamp_and_role():
    first = corrupted(GREY, "gaussian_noise", 1)
    assert np.array_equal(first, corrupted(GREY, "gaussian_noise", 1))
    for changes in ({"seed": 2}, {"stamp_ns": 6}, {"role": "right"}):
        assert not np.array_equal(first, corrupted(GREY, "gaussian_noise", 1, **changes))
    assert np.array_equal(corrupted(GREY, "fog", 1), corrupted(GREY, "fog", 1, role="right"))


def test_jpeg_becomes_worse():
    noisy = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    errors = [np.abs(corrupted(noisy, "jpeg_compression", s).astype(int) - noisy).mean() for s in range(1, 6)]
    assert errors == sorted(errors)
