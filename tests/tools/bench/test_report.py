"""The benchmark's tables are like those of replays, and it measures both ways of reading them."""

import re

import polars as pl
import pytest

from roadperc_stream.eval.runs import find_runs
from roadperc_stream.tools.bench.report import group_by, main, write_dataset
from tests.eval.tables import summary_of


def test_both_ways_read_the_same_values(tmp_path):
    write_dataset(tmp_path, 2, 1500)
    bare = group_by(str(tmp_path)).sort("config")
    paths = sorted(tmp_path.glob("metrics/*/*.parquet"), key=lambda path: path.stem[-8:])
    found = find_runs([str(path) for path in paths])
    assert summary_of(*found).frames == 3000
    summaries = [summary_of(item) for item in found]
    for summary, means, medians in zip(summaries, bare["step_error_m"], bare["step_error_m_0.5"], strict=True):
        statistic = summary.statistics["step_error_m"]
        assert statistic.total / statistic.values == pytest.approx(means)
        assert statistic.median == pytest.approx(medians)
        assert 0.85 < summary.coverage("step_error_m") < 0.95


@pytest.mark.long
def test_it_prints_time_memory_and_ratio(tmp_path, capsys):
    assert main([str(tmp_path), "--files", "2", "--rows", "20"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"roadperc-report +\d+\.\d +\d+\.\d +\d+ +\d+\.\d\d", text)
    assert re.search(r"plain group-by .* 1\.00", text)


def test_tables_are_kept(tmp_path):
    write_dataset(tmp_path, 1, 10)
    (path,) = tmp_path.glob("metrics/*/*.parquet")
    pl.read_parquet(path).head(3).write_parquet(path)
    write_dataset(tmp_path, 2, 10)
    assert sorted(pl.read_parquet(path).height for path in tmp_path.glob("metrics/*/*.parquet")) == [3, 10]
