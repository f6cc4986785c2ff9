from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.errors import DumpError
from roadperc_stream.tools.readers.frame_stamps import EPOCH_NS, stamps_of_file, stamps_of_names, stamps_of_rate


def test_rate_counts_frame_numbers_from_the_first():
    stamps = stamps_of_rate([142916, 142920, 142921], 20.0)
    assert [s - EPOCH_NS for s in stamps.values()] == [0, 200_000_000, 250_000_000]


@given(st.lists(st.integers(0, 10**7), min_size=1, unique=True), st.floats(0.1, 1000.0))
def test_stamps_increase_with_frame_numbers(numbers, rate_hz):
    stamps = list(stamps_of_rate(sorted(numbers), rate_hz).values())
    assert stamps[0] == EPOCH_NS
    assert all(a < b for a, b in pairwise(stamps))


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("3 0.0\n7 0.05\n9 0.1\n", [0.0, 0.05, 0.1]),
        ("frame,seconds\n9,0.1\n3,0.0\n7,0.05\n11,0.2\n", [0.0, 0.05, 0.1]),
        ("# three\n1.5\n\n1.6\n1.036224e+01\n", [1.5, 1.6, 10.36224]),
    ],
)
def test_files_of_seconds(tmp_path, text, seconds):
    path = tmp_path / "timestamps.txt"
    path.write_text(text)
    stamps = stamps_of_file(path, [3, 7, 9])
    assert [stamps[n] - EPOCH_NS for n in (3, 7, 9)] == [round(s * 1e9) for s in seconds]


@pytest.mark.parametrize(
    ("names", "unit_ns"),
    [
        ([1_305_031_102_933_000_000, 1_305_031_102_983_000_000], 1),
        ([1_305_031_102_933_000, 1_305_031_102_983_000], 1000),
        ([1_305_031_102_933, 1_305_031_102_983], 1_000_000),
        ([], None),
        ([0, 1], None),
        ([142_916], None),
        ([20_240_101], None),
    ],
    ids=["ns", "us", "ms", "none", "counted", "simulation", "date"],
)
def test_numbers_that_are_unix_time_are_stamps_and_others_count_frames(names, unit_ns):
    assert stamps_of_names(names) == (unit_ns and {name: name * unit_ns for name in names})


@pytest.mark.parametrize(
    "names",
    [[5, 1_305_031_102_933_000_000], [1_305_031_102_933, 1_305_031_102_933_000]],
    ids=["mixed with a count", "two units"],
)
def test_names_of_two_kinds_are_an_error(names):
    with pytest.raises(DumpError, match=f"names of two kinds, such as {names[0]} and {names[1]}"):
        stamps_of_names(names)


@pytest.mark.parametrize(
    "text", ["2011-09-26 13:02:25.964389445", "5, 2011-09-26T13:02:25.964389445Z", "1317042145.964389445"]
)
def test_dates_and_unix_seconds_are_kept_to_the_nanosecond(tmp_path, text):
    path = tmp_path / "timestamps.txt"
    path.write_text(text + "\n")
    assert stamps_of_file(path, [5]) == {5: 1317042145964389445}


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("0 0.1\n1 0.1\n", "line 2: frame 1 is not later than frame 0"),
        ("0 0.1\n1 nan\n", "line 2: expected"),
        ("0 0.1\n2 0.2\n", "no stamp for frame 1"),
        ("0.1\n0.2\n0.3\n", "3 stamps for 2 frames"),
        ("0 0.1\n0 0.2\n1 0.3\n", "two lines of one frame"),
        ("0 2011-13-26 13:02:25\n", "line 1: expected"),
    ],
)
def test_faults_name_the_line(tmp_path, text, fault):
    path = tmp_path / "timestamps.txt"
    path.write_text(text)
    with pytest.raises(DumpError, match=fault):
        stamps_of_file(path, [0, 1])


def test_rate_does_not_drift():
    stamps = stamps_of_rate([0, 3_000_000], 30.0)
    assert stamps[3_000_000] - EPOCH_NS == 100_000 * 1_000_000_000
