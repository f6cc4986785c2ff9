"""When two values agree, and how fields of messages are named."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.eval.comparison.agreement import ABSENT, Agreement, Difference, distance, together
from roadperc_stream.eval.comparison.messages import without_indices

NAN = math.nan


@pytest.mark.parametrize(
    ("reference", "candidate", "apart"),
    [
        (1.0, 1.0, 0.0),
        (1, 1.5, 0.5),
        (NAN, NAN, 0.0),
        (NAN, 1.0, ABSENT),
        (None, None, 0.0),
        (None, 0.0, ABSENT),
        ("held", "lost", ABSENT),
        (math.inf, math.inf, 0.0),
        (math.inf, 1.0, ABSENT),
    ],
)
def test_distance(reference, candidate, apart):
    assert distance(reference, candidate) == apart
    assert distance(candidate, reference) == apart


@given(st.floats(), st.floats())
def test_distance_of_floats_is_never_negative_and_zero_of_equals_only(a, b):
    same = a == b or (math.isnan(a) and math.isnan(b))
    assert distance(a, b) >= 0
    assert (distance(a, b) == 0) == same


def test_runs_together_keep_the_first_difference():
    first, second = (Difference(run, 3, 7, "x", 1.0, 2.0) for run in "ab")
    parts = [
        {"x": Agreement()},
        {"x": Agreement(1, 2, 0.5, first)},
        {"x": Agreement(0, 1, 0.75, second), "y": Agreement()},
    ]
    assert together(parts) == {"x": Agreement(1, 3, 0.75, first), "y": Agreement()}


@pytest.mark.parametrize(
    ("place", "name"),
    [("boundaries[0].offset_m", "boundaries.offset_m"), ("a[1].b[12].c", "a.b.c"), ("pitch", "pitch"), ("x[3]", "x")],
)
def test_field_names_have_no_indices(place, name):
    assert without_indices(place) == name
