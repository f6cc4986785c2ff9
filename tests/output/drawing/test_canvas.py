"""Drawing depends only on its arguments and the image size."""

import numpy as np
import pytest

from roadperc_stream.output.drawing.canvas import Canvas
from tests.analytic import box

WHITE = (255, 255, 255)


def written(text="Car 10.7 m", rows=960):
    canvas = Canvas(np.zeros((rows, 1280, 3), np.uint8))
    canvas.write(text, (10, 10), WHITE)
    return canvas.pixels


def test_a_text_does_not_depend_on_earlier_texts():
    first = written()
    for rows in (240, 480, 720, 1200):
        written("frame 7 \u00e4\u4e2d 0.35 s", rows)
    np.testing.assert_array_equal(written(), first)


@pytest.mark.parametrize("rows", [240, 480, 960, 2160])
def test_a_text_stays_within_its_text_size(rows):
    canvas, text = Canvas(np.zeros((rows, 1280, 3), np.uint8)), "jgy\u00c4Q 10.7 m"
    width, height = canvas.text_size(text)
    canvas.write(text, (20, 30), WHITE)
    at_rows, at_columns = np.nonzero(canvas.pixels.any(axis=-1))
    assert 30 <= at_rows.min() < at_rows.max() < 30 + height
    assert 20 < at_columns.min() < at_columns.max() < 20 + width
    canvas.write_on_plate(text, (20, 30), WHITE)
    dark = (canvas.pixels == 25).all(axis=-1)
    assert dark[30, 20]
    assert dark[30 + height - 1, 20 + width - 1]
    assert not dark[30 + height].any()
    assert not dark[:, 20 + width].any()


def test_a_box_is_drawn_on_its_outermost_pixels():
    canvas = Canvas(np.zeros((960, 1280, 3), np.uint8))
    canvas.box_outline(box("", 100, 200, 300, 400).box_px, WHITE, 1)
    white = (canvas.pixels == 255).all(axis=-1)
    assert white[200, 100:301].all()
    assert white[200:401, 300].all()
    assert white.sum() == 4 * 200
