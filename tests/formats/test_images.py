"""Numbers in pixels, and masks: whoever reads a mask's PNG finds its pixels and colours."""

import io

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from hypothesis.extra.numpy import arrays
from PIL import Image as PillowImage

from roadperc_stream.formats import images
from roadperc_stream.formats.png import encode_mask

SIDES = st.integers(1, 9)


@given(arrays(np.uint8, st.tuples(SIDES, SIDES, st.just(3))))
def test_instance_ids_have_green_as_low_and_blue_as_high_byte(bgr):
    found = images.instance_ids(bgr)
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, bgr[..., 1] + 256 * bgr[..., 0].astype(int))


def test_millimetres_may_begin_at_an_odd_byte():
    """A message's pixels begin wherever its names end."""
    depth_mm = np.frombuffer(bytes(range(13)), np.uint8)[1:].view("<u2").reshape(2, 3)
    assert not depth_mm.flags.aligned
    np.testing.assert_array_equal(images.depth_from_mm(depth_mm), depth_mm * np.float32(0.001))


def test_depth_is_rounded_to_millimetres():
    depth_mm = np.arange(1 << 16, dtype=np.uint16).reshape(256, -1)
    depth_m = images.depth_from_mm(depth_mm)
    np.testing.assert_array_equal(images.depth_to_mm(depth_m), depth_mm)
    near_m = np.array([[65.535, 65.5351, 3e38, np.inf], [np.nan, 0, -0.0, -np.inf], [1e-45, 0.0005, 0.0015, 0.0025]])
    expected = [[65535, 65535, 65535, 65535], [0, 0, 0, 0], [1, 1, 2, 2]]
    np.testing.assert_array_equal(images.depth_to_mm(near_m.astype(np.float32)), expected)


BLACK, BLUE = (0, 0, 0), (30, 144, 255)
MASKS = arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=40))


@given(MASKS)
def test_every_reader_decodes_the_mask(mask):
    data = encode_mask(mask, (BLACK, BLUE))

    np.testing.assert_array_equal(images.decode_indices(data), mask)
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(bgr, np.where(mask[..., None], BLUE[::-1], BLACK))


@given(MASKS, st.tuples(*[st.integers(0, 255)] * 3))
def test_a_mask_is_a_palette_with_one_bit_a_pixel(mask, colour):
    data = encode_mask(mask, (BLACK, colour))

    with PillowImage.open(io.BytesIO(data)) as image:
        image.verify()  # its checksums
    with PillowImage.open(io.BytesIO(data)) as image:
        assert (image.mode, image.size) == ("P", mask.shape[::-1])
        assert image.getpalette() == [*BLACK, *colour]
    assert data[24:26] == b"\x01\x03", "bits a pixel, and kind of colours"


def test_the_memory_order_of_a_mask_does_not_matter():
    mask = np.arange(35).reshape(5, 7) % 3 == 0

    assert encode_mask(np.asfortranarray(mask), (BLACK, BLUE)) == encode_mask(mask, (BLACK, BLUE))
    assert encode_mask(np.repeat(mask, 2, axis=1)[:, ::2], (BLACK, BLUE)) == encode_mask(mask, (BLACK, BLUE))
