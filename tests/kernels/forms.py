"""Both forms of the kernels, and numbers to compare them with."""

import importlib

import numpy as np
import pytest
from hypothesis import strategies as st

SEEDS = st.integers(0, 2**32 - 1)
SHAPES = st.tuples(st.integers(0, 14), st.integers(0, 14))


def forms(room):
    """The numpy form and the compiled form of a room's kernels."""
    names = (f"roadperc_stream.kernels.{room}_{form}" for form in ("plain", "compiled"))
    return [importlib.import_module(next(names)), pytest.importorskip(next(names))]


def both(room):
    """Run a test with each form."""
    return pytest.mark.parametrize("kernel", forms(room), ids=["plain", "compiled"])


def assert_same_bits(room, function, *asked):
    """Assert that both forms give the same results, and write the same into their arguments."""
    written = []
    for kernel in forms(room):
        ours = [a.copy() if isinstance(a, np.ndarray) and a.flags.c_contiguous else a for a in asked]
        with np.errstate(all="ignore"):
            found = getattr(kernel, function)(*ours)
        written.append((*(found if isinstance(found, tuple) else (found,)), *ours))
    for expected, found in zip(*written, strict=True):
        if isinstance(expected, np.ndarray):
            np.testing.assert_array_equal(found, expected, strict=True)
        else:
            assert expected == found


def wild(rng, shape, largest):
    """Float32 numbers: quarters, any, unknown, infinite, negative and extreme ones."""
    found = rng.uniform(0, largest, shape)
    found = np.where(rng.random(shape) < 0.5, np.rint(4 * found) / 4, found)
    special = rng.choice((np.nan, np.inf, -np.inf, 0.0, -0.0, -1.5, 1e-45, 3e38, -3e38), shape)
    return np.where(rng.random(shape) < rng.choice((0.0, 0.2)), special, found).astype(np.float32)
