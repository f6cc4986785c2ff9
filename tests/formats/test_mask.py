"""A mask's PNG: whoever reads it finds the mask's own pixels, and its colours."""

import io

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image as PillowImage

from roadperc_stream.formats.images import decode_indices
from roadperc_stream.formats.mask import encode_mask

BLACK, BLUE = (0, 0, 0), (30, 144, 255)
MASKS = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=40))


@given(MASKS)
def test_every_reader_finds_its_pixels(mask):
    data = encode_mask(mask, (BLACK, BLUE))

    np.testing.assert_array_equal(decode_indices(data), mask)
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(bgr, np.where(mask[..., None], BLUE[::-1], BLACK))


@given(MASKS, st.tuples(*[st.integers(0, 255)] * 3))
def test_it_is_a_palette_of_two_colours_with_a_bit_a_pixel(mask, colour):
    data = encode_mask(mask, (BLACK, colour))

    with PillowImage.open(io.BytesIO(data)) as image:
        image.verify()  # its checksums
    with PillowImage.open(io.BytesIO(data)) as image:
        assert (image.mode, image.size) == ("P", mask.shape[::-1])
        assert image.getpalette() == [*BLACK, *colour]
    assert data[24:26] == b"\x01\x03", "bits a pixel, and kind of colours"


def test_a_mask_in_any_order_of_memory_is_the_same_file():
    mask = np.arange(35).reshape(5, 7) % 3 == 0

    assert encode_mask(np.asfortranarray(mask), (BLACK, BLUE)) == encode_mask(mask, (BLACK, BLUE))
    assert encode_mask(np.repeat(mask, 2, axis=1)[:, ::2], (BLACK, BLUE)) == encode_mask(mask, (BLACK, BLUE))
