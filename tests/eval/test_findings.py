"""Findings in the report and in roadperc-check: of one run, of several, of continued ones, and of a dataset."""

import json

import pytest

from roadperc_stream.cli import check, report
from roadperc_stream.eval.criteria import read_criteria
from roadperc_stream.model.finding import Finding, encoded_findings
from tests import logs
from tests.batch.dataset import batch, runs
from tests.eval.dataset.datasets import add_table, done, frames, write_runs
from tests.eval.tables import outcome, row, write
from tests.output.test_findings import WRONG, items

HEIGHT, LANE = Finding("camera_height", "7 m, not 1.4 m"), Finding("lane_width", "16.9 m")
CRITERION = 'criterion = [{ statistic = "findings", most = 0 }]'


def table(path, *findings, **facts):
    return write(path, [row(frame) for frame in range(3)], findings=encoded_findings(findings), **facts)


def heads(out):
    return [line for line in out.splitlines() if line.startswith("finding ")]


def test_several_runs_show_how_many_have_a_finding(tmp_path, capsys):
    for name, findings in {"a": (HEIGHT, LANE), "b": (HEIGHT,), "c": ()}.items():
        table(tmp_path / f"{name}.metrics.parquet", *findings, log=name)
    for options in ((), ("--full",)):
        out = outcome(report.main, capsys, tmp_path, "--json", tmp_path / "report.json", *options)[1]
        assert out.splitlines()[:2] == heads(out)
        assert "camera_height in 2 of 3 runs" in heads(out)[0]
        assert HEIGHT.text in heads(out)[0]
    counts = json.loads((tmp_path / "report.json").read_text())["findings"]
    assert {code: count["runs"] for code, count in counts.items()} == {"camera_height": 2, "lane_width": 1}


def test_continued_replays_have_the_findings_of_all_parts(tmp_path, capsys):
    first, second = {"log_id": "a" * 16}, {"log_id": "b" * 16, "continues": "a" * 16, "first_frame": "3"}
    table(tmp_path / "a.metrics.parquet", HEIGHT, **first)
    rows = [row(frame, "b" * 16) for frame in range(3, 6)]
    write(tmp_path / "b.metrics.parquet", rows, findings=encoded_findings([LANE, HEIGHT]), **second)
    out = outcome(report.main, capsys, tmp_path)[1]
    assert {line.split(":")[0] for line in heads(out)} == {"finding camera_height", "finding lane_width"}


@pytest.mark.parametrize(
    ("stored", "most", "code"),
    [((HEIGHT,), 0, 1), ((HEIGHT,), 1, 0), ((), 0, 0), (None, 0, 3)],
)
def test_a_criterion_on_findings(tmp_path, capsys, stored, most, code):
    facts = {} if stored is None else {"findings": encoded_findings(stored)}
    path = write(tmp_path / "out.metrics.parquet", [row(0)], **facts)
    (tmp_path / "c.toml").write_text(CRITERION.replace("most = 0", f"most = {most}"))
    given, out, err = outcome(check.main, capsys, path, "--criteria", tmp_path / "c.toml")
    assert given == code, out + err
    assert (HEIGHT.text in out) == (code == 1)


def test_the_criterion_names_each_log_on_request_and_refuses_a_filter(tmp_path, capsys):
    paths = [table(tmp_path / f"{name}.metrics.parquet", *found) for name, found in (("a", (LANE,)), ("b", ()))]
    (tmp_path / "c.toml").write_text(CRITERION.replace("most = 0", "most = 0, per_log = true"))
    out = outcome(check.main, capsys, *paths, "--criteria", tmp_path / "c.toml")[1]
    assert "1 of 2 logs, worst a" in out
    (tmp_path / "c.toml").write_text(CRITERION.replace("most = 0", 'most = 0, filter = "frame > 1"'))
    assert "filter" in outcome(check.main, capsys, *paths, "--criteria", tmp_path / "c.toml")[2]


def test_written_criteria_limit_the_findings(tmp_path, capsys):
    path = write(tmp_path / "out.metrics.parquet", [row(0, lane_left_error_m=0.1)], findings=encoded_findings([LANE]))
    assert outcome(check.main, capsys, path, "--init", tmp_path / "c.toml")[0] == 0
    assert [found.most for found in read_criteria(tmp_path / "c.toml") if found.statistic == "findings"] == [1]


def test_a_dataset_counts_the_runs_with_a_finding(tmp_path, capsys):
    for number in (1, 2):
        add_table(tmp_path, frames(number, [0.1]))
    rows = [done(1, frames=1, findings=(str(HEIGHT), str(LANE))), done(2, frames=1), done(3, status="damaged")]
    write_runs(tmp_path / "runs.parquet", rows)
    for options in ((), ("--by", "log"), ("--full",)):
        out = outcome(report.main, capsys, tmp_path, *options)[1]
        assert "camera_height in 1 of 2 runs" in out.splitlines()[0]


def test_the_findings_of_a_log_reach_the_dataset(tmp_path, capsys):
    source = logs.write(tmp_path / "in.mcap", items(**WRONG["camera_height"]))
    assert batch(tmp_path / "out", source).returncode == 0
    assert runs(tmp_path / "out")["findings"].to_list()[0][0].startswith("camera_height: ")
    code, out, _ = outcome(check.main, capsys, tmp_path / "out")
    assert code == 1
    assert "camera_height" in out
