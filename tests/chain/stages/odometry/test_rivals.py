"""A street whose texture repeats: along its whole length, or except on one wall."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.odometry.rivals import _judged
from tests.chain.stages.odometry.street import TEXTURES, drive, photograph, run

REPEATED_TEXELS = 8
"""A repetition of 0.4 m."""
STEP_M = 0.31
"""Nearer to one repetition than to standing still."""


def shots(unique_wall):
    textures = [np.tile(pattern[:, :REPEATED_TEXELS], (1, len(pattern) // REPEATED_TEXELS)) for pattern in TEXTURES]
    if unique_wall:
        textures[1] = TEXTURES[1]
    return [photograph(pose, textures=(*textures[:3], TEXTURES[3])) for pose in drive(4, STEP_M, turn=0.0)]


def errors_and_deviations(results):
    for out in results[1:]:
        variance = np.reshape(out.covariance, (6, 6))[0, 0]
        yield abs(np.linalg.norm(out.step[:3, 3]) - STEP_M), np.sqrt(variance)


def test_in_a_repetitive_street_the_deviation_covers_the_error():
    _, results = run(shots(unique_wall=False))
    assert all(error < 3 * std for error, std in errors_and_deviations(results))


def test_what_is_unique_decides():
    _, results = run(shots(unique_wall=True))
    assert all(error < 0.01 and std < 0.05 for error, std in errors_and_deviations(results))


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ((0.1, 0.2, 0.9, 1.0, 0.9, 0.2, 0.1), (0.0, 0.0)),
        ((0.2, 1.0, 0.2, 0.9, 0.2, 0.9, 0.2), (0.0, 2.0)),
        ((0.2, 1.0, 0.2, 0.5, 0.2, 0.9, 0.2), (-2.0, 4.0)),
        ((1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0), (0.0, 0.0)),
    ],
)
def test_shifts_that_fit_as_well_are_rivals(scores, expected):
    assert _judged(np.arange(-3.0, 4.0), np.array(scores)) == expected
