"""What the compiled kernel sees is what numpy sees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadperc_stream.chain.kernels import stereo_plain

compiled = pytest.importorskip("roadperc_stream.chain.kernels.stereo_compiled")

DISPARITIES = st.one_of(
    st.integers(-2, 40).map(lambda number: number / 4),
    st.floats(-1.0, 12.0, width=32),
    st.sampled_from([np.nan, np.inf]),
)


@given(arrays(np.float32, st.tuples(st.integers(0, 4), st.integers(0, 12)), elements=DISPARITIES), st.floats(0.0, 2.0))
def test_both_ways_see_the_same(disparity_px, occlusion_px):
    expected = stereo_plain.seen_by_both(disparity_px, occlusion_px)
    found = compiled.seen_by_both(disparity_px, occlusion_px)
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)


def test_a_view_of_every_second_column_is_seen_too():
    disparity_px = np.random.default_rng(0).uniform(0, 30, (20, 80)).astype(np.float32)[:, ::2]
    np.testing.assert_array_equal(
        compiled.seen_by_both(disparity_px, 1.0), stereo_plain.seen_by_both(disparity_px, 1.0)
    )
