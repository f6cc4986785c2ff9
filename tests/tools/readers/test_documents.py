import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.tools.readers.documents import EPOCH_NS, by_frame, frame_number


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("frame_00001", 1),
        ("142916", 142916),
        ("000084", 84),
        ("a1_b2_c", 2),
        ("left", None),
        ("", None),
        ("1305031102.933", 1_305_031_102_933_000_000),
        ("rgb_1305031102.000000001", 1_305_031_102_000_000_001),
        ("v1.2_1305031102", 1_305_031_102),
        ("130503110.933", 933),
        ("12.80", EPOCH_NS + 12_800_000_000),
        ("rgb_0013.050", EPOCH_NS + 13_050_000_000),
        ("12.850000000000001", EPOCH_NS + 12_850_000_000),
        ("shot1.0001", 1),
        ("0.9.15", 15),
        ("frankfurt_000000_000294_leftImg8bit", 294),
        ("frankfurt_000000_000294_gtFine_labelIds", 294),
    ],
)
def test_the_last_group_of_digits_is_the_frame(name, number):
    assert frame_number(name) == number


@given(st.dictionaries(st.integers(0, 10**6), st.integers()))
def test_zeros_in_front_do_not_matter(entries):
    assert by_frame("x.json", {f"{number:08d}": entry for number, entry in entries.items()}) == entries
