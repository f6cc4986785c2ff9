"""The settings of a run, from its table, and the settings that differ."""

import hashlib
from pathlib import Path

import pytest

from roadperc_stream.config import load_config
from roadperc_stream.eval.configurations import (
    change,
    differing,
    grouped,
    settings_table,
)
from roadperc_stream.eval.runs import Run

SLOW = load_config(settings=("lanes.hold_s=2",)).to_toml()


def digest(toml):
    return hashlib.sha256(toml.encode()).hexdigest()


def run(name="a", toml="", version="1", made_by=None):
    made_by = digest(toml) if made_by is None else made_by
    return Run(name, Path(f"/nowhere/{name}.metrics.parquet"), 1, frozenset(), made_by, version, toml)


def test_differing_values_and_settings_that_one_version_lacks():
    ours = {"seed": 0, "lanes.hold_s": 0.5, "lanes.enabled": True}
    theirs = {"seed": 0, "lanes.enabled": False, "lanes.new": "x"}
    assert differing([ours, theirs]) == {
        "lanes.hold_s": ("0.5", "-"),
        "lanes.enabled": ("true", "false"),
        "lanes.new": ("-", "x"),
    }


def test_a_group_has_one_configuration_and_version():
    runs = [run("a", "seed = 1"), run("b", "seed = 2"), run("c", "seed = 1"), run("d", "seed = 1", version="2")]
    groups = grouped(runs)
    first = digest("seed = 1")[:8]
    assert [group.name for group in groups] == [f"{first} 1", "b", "d"]
    assert [[item.name for item in group.runs] for group in groups] == [["a", "c"], ["b"], ["d"]]


def test_the_table_has_a_row_for_each_setting_and_names_unknown_configurations():
    runs = {"a": run("a", "seed = 1"), "b": run("b", "seed = 2"), "c": run("c", made_by="0" * 64)}
    table = settings_table(runs)
    assert table.rows == [("seed", "1", "2", "unknown")]
    assert table.headers == ("a", "b", "c")
    assert table.notes == ("unknown: no configuration in the table: c",)


def test_one_configuration_gives_no_table_and_two_versions_give_a_note():
    one, other = run("a", "seed = 1"), run("b", "seed = 1", version="2")
    same = settings_table({"a": one, "b": one})
    assert (list(same.rows), list(same.notes)) == ([], [])
    assert settings_table({"a": one, "b": other}).notes == ("none: the versions differ",)


def test_the_source_of_an_own_stage_is_shown_by_the_first_digits_of_its_digest():
    rows = differing([{"lanes.implementation_source": f"sha256 {digit * 64}"} for digit in "ab"])
    assert rows == {"lanes.implementation_source": ("sha256 aaaaaaaa", "sha256 bbbbbbbb")}


UNKNOWN_CONFIGURATION = "unknown, because a run has no configuration in its table"


@pytest.mark.parametrize(
    ("candidate", "expected"),
    [
        (run("b", "seed = 1"), ()),
        (run("b", "seed = 2"), ("", "seed 1 → 2")),
        *((run("b", made_by=digest), (UNKNOWN_CONFIGURATION,)) for digest in ("0" * 64, "")),
        (run("b", "lanes = "), (UNKNOWN_CONFIGURATION,)),
    ],
)
def test_changed_settings_of_two_runs(candidate, expected):
    assert change(run("a", "seed = 1"), candidate) == expected


def test_a_long_value_is_shown_by_its_length_and_digest():
    """Two pictures with the same first and last characters still differ."""
    one, other = (f"iVBOR{middle * 200}ggg==" for middle in "ab")
    (values,) = differing([{"objects.template_png": picture} for picture in (one, other)]).values()
    assert [value.partition(" with sha256 ")[0] for value in values] == ["210 characters"] * 2
    assert values[0] != values[1]
