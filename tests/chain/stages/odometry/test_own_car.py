"""The own car in the lower image, found by rows that stay the same while the road moves."""

import cv2
import numpy as np
import pytest

from roadperc_stream.chain.stages.odometry.own_car import band_correlations, first_row, without_own_car

ROWS, COLUMNS, BONNET = 240, 320, 204


def image(seed, shift_px, bonnet=True):
    """Grain that moves down by a shift, over a bonnet that does not; each image has its own noise."""
    grain = cv2.GaussianBlur(np.random.default_rng(0).normal(110, 60, (ROWS + 200, COLUMNS)), (0, 0), 1.2)
    grey = grain[100 - shift_px : 100 - shift_px + ROWS].copy()
    if bonnet:
        grey[BONNET:] = grain[-(ROWS - BONNET) :] - 40
    return np.clip(grey + np.random.default_rng(seed).normal(0, 3, grey.shape), 0, 255).astype(np.uint8)


def test_a_bonnet_is_found_while_the_road_moves():
    correlations = band_correlations(image(1, 0), image(2, 9), ())
    assert BONNET - 16 < first_row(correlations, ROWS) <= BONNET
    assert first_row(band_correlations(image(1, 0, bonnet=False), image(2, 9, bonnet=False), ()), ROWS) == ROWS


def test_a_standing_car_keeps_what_is_known():
    assert first_row(band_correlations(image(1, 0), image(2, 0), ()), ROWS) == ROWS
    correlations = band_correlations(image(1, 0), image(2, 9), ())
    assert band_correlations(image(3, 9), image(4, 9), correlations) == correlations


@pytest.mark.parametrize("movable", [None, np.zeros((ROWS, COLUMNS), np.uint8)])
def test_the_rows_of_the_own_car_are_movable(movable):
    marked = without_own_car(movable, BONNET, (ROWS, COLUMNS))
    assert marked[BONNET:].all()
    assert not marked[:BONNET].any()
    assert without_own_car(movable, ROWS, (ROWS, COLUMNS)) is movable


def test_images_of_a_few_rows_show_no_own_car():
    grey = np.zeros((11, 15), np.uint8)
    assert band_correlations(grey, grey, ()) == ()
    assert first_row((), 11) == 11
