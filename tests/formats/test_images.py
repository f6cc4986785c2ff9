"""Numbers in pixels."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadperc_stream.formats import images

SIDES = st.integers(1, 9)


@given(arrays(np.uint8, st.tuples(SIDES, SIDES, st.just(3))))
def test_instance_ids_have_green_as_low_and_blue_as_high_byte(bgr):
    found = images.instance_ids(bgr)
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, bgr[..., 1] + 256 * bgr[..., 0].astype(int))


def test_millimetres_that_begin_at_an_odd_byte_are_not_read_there(monkeypatch):
    """A message's pixels begin wherever its names end; a compiled loop may want numbers at multiples of their size."""
    seen = []
    monkeypatch.setattr(
        images, "metres_of_mm", lambda depth_mm, _: seen.append(depth_mm.copy()) or seen.append(depth_mm)
    )
    depth_mm = np.frombuffer(bytes(range(13)), np.uint8)[1:].view("<u2").reshape(2, 3)
    assert not depth_mm.flags.aligned
    images.depth_from_mm(depth_mm)
    np.testing.assert_array_equal(seen[0], depth_mm)
    assert seen[1].flags.aligned


def test_a_known_instance_of_bytes_that_nobody_may_write():
    assert images.instance_ids(np.frombuffer(b"\x02\x01\x0e", np.uint8).reshape(1, 1, 3)) == 2 * 256 + 1
