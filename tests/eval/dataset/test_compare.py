"""Comparison of two configurations of a dataset, log by log."""

import re
import shlex
from functools import partial

import pytest

from roadperc_stream.cli.compare import main
from tests.eval.dataset.datasets import A, B, add_table, compact, done, frames, small_dataset, write_runs
from tests.eval.tables import outcome, usage_error

compare = partial(outcome, main)


@pytest.fixture
def dataset(tmp_path):
    return small_dataset(tmp_path / "dataset")


@pytest.mark.parametrize(("first", "second"), [(B[:2], "default"), ("lanes.hold_s=2.0", A), ("lanes.hold_s=2", A)])
def test_digits_and_settings_identify_a_configuration(dataset, capsys, first, second):
    code, text, _ = compare(capsys, dataset, "--base-config", first, "--new-config", second)
    assert (code, "better: lane left error at 10 m, mean 0.27" in text) == (0, True)


def test_each_side_can_be_a_dataset(dataset, capsys, tmp_path):
    other = small_dataset(tmp_path / "other")
    together = compare(capsys, dataset)
    sides = compare(capsys, dataset, other, "--base-config", A, "--new-config", B)
    printed = sides[1].replace(shlex.join([str(dataset), str(other)]), shlex.quote(str(dataset)))
    assert (sides[0], printed) == together[:2]
    code, _, error = compare(capsys, dataset, other, "--base-config", A)
    assert (code, "--new-config: matches 2 configurations" in error) == (3, True)


def test_compacted_tables_give_the_same_comparison(dataset, capsys):
    compared = compare(capsys, dataset)
    compact(dataset, "2026-01-01")
    code, text, error = compare(capsys, dataset)
    assert (code, re.sub(r"\S+\.mcap", "", text), error) == (1, re.sub(r"\S+\.mcap", "", compared[1]), compared[2])


@pytest.mark.parametrize(
    ("configs", "said"),
    [
        (("x", A), "--base-config x: matches no configuration"),
        ((A, A[:3]), "expected two configurations"),
    ],
)
def test_options_that_are_not_two_configurations_are_errors(dataset, capsys, configs, said):
    code, _, error = compare(capsys, dataset, "--base-config", configs[0], "--new-config", configs[1])
    assert code == 3
    assert said in error
    assert f"the dataset has {A} (default); {B} (lanes.hold_s=2.0)" in error


def test_three_configurations_need_options(dataset, capsys):
    add_table(dataset, frames(1, [0.1] * 4), "cccc0000")
    code, _, error = compare(capsys, dataset, "--base-config", A)
    assert code == 3
    assert "pass --base-config and --new-config" in error
    assert "cccc0000 (unknown)" in error


def test_no_tables(tmp_path, capsys):
    write_runs(tmp_path / "runs.parquet", [done(1)])
    code, _, error = compare(capsys, tmp_path)
    assert code == 3
    assert "no tables in metrics/date=.../" in error


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("elsewhere",), "elsewhere: expected NEW, or the OUT_DIR of a batch as BASE"),
        (("a", "b", "--new-config", "c"), "--new-config needs the OUT_DIR of a batch, found b"),
        (("DATASET", "--update-reference"), "--update-reference needs BASE and NEW"),
        (("DATASET", "b", "--update-reference"), "it does not update the OUT_DIR of a batch"),
    ],
)
def test_wrong_usage(dataset, capsys, arguments, said):
    assert said in usage_error(main, capsys, *(dataset if word == "DATASET" else word for word in arguments))


def test_the_error_of_a_truncated_table_names_it(dataset, capsys):
    tables = sorted(dataset.glob("metrics/*/*.parquet"))
    tables[1].write_bytes(tables[1].read_bytes()[:-100])
    code, _, said = compare(capsys, dataset)
    assert (code, said.count("\n")) == (3, 1)
    assert str(tables[1]) in said
