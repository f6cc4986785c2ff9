"""What the simulation starts from, and what it prints."""

import polars as pl
import pytest

from roadperc_stream.errors import TableError
from roadperc_stream.tools.bench.fleet import FleetCosts
from roadperc_stream.tools.bench.fleet_costs import driver_s, measured, scan_s, usual_lengths
from roadperc_stream.tools.bench.scaling import main

OPTIONS = ("--logs", "300", "--workers", "1", "10", "1000", "--driver-s", "0.002")
RUNS = {
    "status": ["done", "done", "damaged"],
    "frames": [100, 300, 0],
    "duration_s": [10.0, 30.0, None],
    "size_bytes": [1000, 7000, 5],
    "seconds": [3.0, 7.0, 1.0],
    "total_s": [2.0, 6.0, None],
}


def printed(capsys, *options):
    """All but what was measured."""
    assert main([*OPTIONS, *options]) == 0
    return capsys.readouterr().out.rpartition("300 tables of metrics")[0]


def test_the_same_seed_gives_the_same_table(capsys):
    first = printed(capsys, "--seed", "3")
    assert printed(capsys, "--seed", "3") == first
    assert printed(capsys, "--seed", "4") != first
    assert "longest log" in first.splitlines()[-1]


def test_split_logs_end_sooner(capsys):
    whole, split = (printed(capsys, *options).splitlines()[-1].split() for options in ((), ("--split", "60")))
    assert whole[0] == split[0] == "1000"
    assert float(split[1]) < float(whole[1])


def test_the_usual_lengths_are_of_minutes():
    lengths_s = usual_lengths(20_000, 1)
    assert sorted(lengths_s)[10_000] == pytest.approx(120, rel=0.03)
    assert sum(lengths_s) / 20_000 == pytest.approx(120 * 2.718**0.5, rel=0.05)


def test_costs_of_a_list_of_runs(tmp_path):
    pl.DataFrame(RUNS).write_parquet(tmp_path / "runs.parquet")
    lengths_s, costs = measured(tmp_path / "runs.parquet", 50, 1, FleetCosts(driver_s=0.5))
    assert set(lengths_s) == {10.0, 30.0}
    assert costs == FleetCosts(frames_per_s=10.0, frame_s=0.02, frame_bytes=20.0, start_s=1.0, driver_s=0.5)


def test_a_list_without_a_log(tmp_path):
    pl.DataFrame(RUNS).tail(1).write_parquet(tmp_path / "runs.parquet")
    with pytest.raises(TableError, match=r"runs.parquet: no log in it is done"):
        measured(tmp_path / "runs.parquet", 5, 1, FleetCosts())
    (tmp_path / "runs.parquet").write_text("no table")
    with pytest.raises(TableError, match=r"runs.parquet: expected a list of runs"):
        measured(tmp_path / "runs.parquet", 5, 1, FleetCosts())


def test_what_is_measured_is_measured(tmp_path):
    assert 0 < driver_s(20, 5, tmp_path) < 1
    assert pl.read_parquet(tmp_path / "runs.parquet").height == 20
    assert 0 < scan_s(5, 10, tmp_path / "tables") < 1
