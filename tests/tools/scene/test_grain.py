"""The noise that surfaces are drawn with."""

import numpy as np
import pytest

from roadperc_stream.tools.scene.grain import pink_noise, pink_spectrum


@pytest.mark.parametrize("fall", [1.0, 0.5])
def test_the_noise_falls_with_frequency_but_for_waves_of_more_than_a_hundred_texels(fall):
    shape = (512, 512)
    spectrum = np.abs(pink_spectrum(shape, np.random.default_rng(0), fall)) ** 2
    frequency = np.hypot(np.fft.fftfreq(512)[:, None], np.fft.rfftfreq(512)[None, :])

    def strength(low, high):
        return spectrum[(frequency >= low) & (frequency < high)].mean()

    reference = strength(0.09, 0.11) * 0.1 ** (2 * fall)
    assert strength(0.38, 0.42) * 0.4 ** (2 * fall) == pytest.approx(reference, rel=0.15)
    assert strength(0.019, 0.021) * 0.02 ** (2 * fall) == pytest.approx(reference, rel=0.3)
    assert strength(0.0, 0.01) * 0.01 ** (2 * fall) == pytest.approx(reference, rel=0.4)


def test_pink_noise_has_unit_deviation_and_repeats():
    noise = pink_noise((128, 256), np.random.default_rng(0))
    assert noise.std() == pytest.approx(1.0, abs=1e-5)
    inside = np.abs(np.diff(noise, axis=1)).mean()
    assert np.abs(noise[:, 0] - noise[:, -1]).mean() < 1.3 * inside
