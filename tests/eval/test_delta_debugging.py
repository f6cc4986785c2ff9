"""ddmin: the result fails, no item of it can be left out, and monotony saves tests."""

from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.eval.bisect.delta_debugging import ddmin

SIZE = 24


class Needing:
    """Fails if a part contains all ``needed``; keeps the tested parts."""

    def __init__(self, needed):
        self.needed, self.tested = set(needed), []

    def __call__(self, part):
        self.tested.append(tuple(part))
        return self.needed <= set(part)


@given(st.sets(st.integers(0, SIZE - 1), min_size=1))
def test_the_needed_items_remain_in_order(needed):
    needing = Needing(needed)
    assert list(ddmin(range(SIZE), needing)) == sorted(needed)
    assert len(set(needing.tested)) == len(needing.tested)


@given(st.integers(0, SIZE - 1), st.integers(0, SIZE - 1))
def test_of_a_span_the_two_ends_remain(one, other):
    first, last = sorted((one, other))
    needing = Needing((first, last))
    assert list(ddmin(range(SIZE), needing, span=True)) == list(range(first, last + 1))
    assert all(list(part) == list(range(part[0], part[-1] + 1)) for part in needing.tested)
    assert len(needing.tested) <= 2 * SIZE.bit_length() + 2


def test_parts_of_passing_parts_are_not_tested():
    needing = Needing({10})
    assert list(ddmin(range(SIZE), needing, passed=[range(10)], span=True)) == [10]
    assert not any(set(part) <= set(range(10)) for part in needing.tested)


def test_one_of_eight_settings_takes_six_tests():
    for needed in range(8):
        needing = Needing({needed})
        assert list(ddmin(range(8), needing)) == [needed]
        assert len(needing.tested) <= 6


def test_a_single_item_is_not_tested():
    needing = Needing({0})
    assert list(ddmin([0], needing)) == [0]
    assert needing.tested == []
