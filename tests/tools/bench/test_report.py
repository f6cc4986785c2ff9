"""The benchmark's tables are those of replays, and it measures both ways of reading them."""

import re

import polars as pl
import pytest

from roadperc_stream.eval.runs import find_runs
from roadperc_stream.eval.summary import summarise_all
from roadperc_stream.tools.bench.report import group_by, main, write_tables


def test_both_ways_read_the_same_values(tmp_path):
    write_tables(tmp_path, 2, 1500)
    bare = group_by(str(tmp_path)).sort("log_id")
    summaries, together = summarise_all(find_runs([str(tmp_path)]), 1)
    assert together.frames == 3000
    for summary, means, medians in zip(summaries, bare["step_error_m"], bare["step_error_m_0.5"], strict=True):
        found = summary.statistics["step_error_m"]
        assert found.total / found.values == pytest.approx(means)
        assert found.median == pytest.approx(medians)
        assert 0.85 < summary.coverage("step_error_m") < 0.95


def test_what_is_there_is_kept(tmp_path):
    write_tables(tmp_path, 1, 10)
    (path,) = tmp_path.iterdir()
    pl.read_parquet(path).head(3).write_parquet(path)
    write_tables(tmp_path, 2, 10)
    assert sorted(pl.read_parquet(path).height for path in tmp_path.iterdir()) == [3, 10]


def test_it_prints_time_memory_and_ratio(tmp_path, capsys):
    assert main([str(tmp_path), "--files", "2", "--rows", "20"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"roadperc-report +│ +\d+\.\d +│ +\d+\.\d +│ +\d+ +│ +\d+\.\d\d", text)
    assert re.search(r"bare group-by +│ .*│ 1\.00", text)


def test_a_report_that_fails_is_an_error(tmp_path, capsys):
    (tmp_path / "1x10").mkdir()
    (tmp_path / "1x10" / "log00000.metrics.parquet").write_bytes(b"no parquet")
    assert main([str(tmp_path), "--files", "1", "--rows", "10"]) == 1
    assert "roadperc-report ended with exit code 1" in capsys.readouterr().err
