"""Two configurations of a dataset against each other, log by log."""

from functools import partial

import pytest

from roadperc_stream.cli.compare import main
from tests.eval.dataset.datasets import A, B, add_table, compact, done, frames, small_dataset, write_runs
from tests.eval.tables import outcome, usage_error

compare = partial(outcome, main)


@pytest.fixture
def dataset(tmp_path):
    return small_dataset(tmp_path / "dataset")


def test_the_other_way_round_it_is_better(dataset, capsys):
    code, text, _ = compare(capsys, dataset, "--config", B[:2], "--config", "default")
    assert code == 0
    assert "better: lane_left_error_m 0.27" in text


@pytest.mark.parametrize("setting", ["lanes.hold_s=2.0", "lanes.hold_s=2"])
def test_a_setting_names_a_configuration(dataset, capsys, setting):
    assert compare(capsys, dataset, "--config", setting, "--config", A)[0] == 0


def test_compacted_tables_compare_alike(dataset, capsys):
    before = compare(capsys, dataset)
    compact(dataset, "2026-01-01")
    assert compare(capsys, dataset) == before


@pytest.mark.parametrize(
    ("configs", "said"),
    [
        (("x", A), "--config x: names no configuration"),
        ((A, A[:3]), "are the same"),
        ((A,), "expected --config twice, found it 1 times"),
    ],
)
def test_what_is_no_pair_of_configurations(dataset, capsys, configs, said):
    code, _, error = compare(capsys, dataset, *(word for name in configs for word in ("--config", name)))
    assert code == 1
    assert said in error
    assert f"the dataset has {A} (default); {B} (lanes.hold_s=2.0)" in error


def test_of_three_two_must_be_named(dataset, capsys):
    add_table(dataset, frames(1, [0.1] * 4), "cccc0000")
    code, _, error = compare(capsys, dataset)
    assert code == 1
    assert "expected --config twice, found it 0 times" in error
    assert "cccc0000 (unknown)" in error


def test_no_tables(tmp_path, capsys):
    write_runs(tmp_path / "runs.parquet", [done(1)])
    code, _, error = compare(capsys, tmp_path)
    assert code == 1
    assert "no tables in metrics/date=.../" in error


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("elsewhere",), "elsewhere: expected B, or the OUT_DIR of a batch as A"),
        (("a", "b", "--config", "c"), "--config compares two configurations of the dataset A"),
        (("DATASET", "--update-reference"), "--update-reference needs A and B"),
    ],
)
def test_wrong_usage(dataset, capsys, arguments, said):
    assert said in usage_error(main, capsys, *(dataset if word == "DATASET" else word for word in arguments))


def test_a_table_that_is_cut_off_is_named(dataset, capsys):
    tables = sorted(dataset.glob("metrics/*/*.parquet"))
    tables[1].write_bytes(tables[1].read_bytes()[:-100])
    code, _, said = compare(capsys, dataset)
    assert (code, said.count("\n")) == (1, 1)
    assert str(tables[1]) in said
