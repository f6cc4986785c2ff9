"""Names that fit on a line: whole where they fit, both ends where not, never two alike."""

from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.eval.names import legend, short_names

NAMES = st.lists(st.text("abcdefg/_0123456789", min_size=1, max_size=60), unique=True, min_size=1, max_size=12)


def test_what_fits_stays_and_needs_no_legend():
    names = short_names(["base/drive", "slow/drive"], 15)
    assert names == {"base/drive": "base/drive", "slow/drive": "slow/drive"}
    assert list(legend(names)) == []


def test_the_ends_stay_and_the_legend_has_the_whole_name():
    names = short_names(["base/the_long_name_of_a_drive"], 15)
    assert list(names.values()) == ["base/th…a_drive"]
    assert list(legend(names)) == ["base/th…a_drive: base/the_long_name_of_a_drive"]


def test_names_that_differ_in_the_middle_are_numbered():
    names = short_names(["runs_of_today/a/town_drive", "runs_of_today/b/town_drive", "c"], 15)
    assert list(names.values()) == ["1 runs_o…_drive", "2 runs_o…_drive", "c"]


@given(NAMES, st.integers(15, 60))
def test_every_name_fits_and_is_its_own(names, columns):
    short = short_names(names, columns)
    assert list(short) == names
    assert max(map(len, short.values())) <= columns
    assert len(set(short.values())) == len(names)
