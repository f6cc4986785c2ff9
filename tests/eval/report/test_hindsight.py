"""Errors by hindsight in the report, in check and in compare: they judge each output whose truth is missing."""

import json
from functools import partial

import numpy as np
import pytest

from roadperc_stream.cli import check, compare, report
from tests.eval.tables import object_rows, outcome, row, write

COUNT = 40
LATER = {"lane_left_hindsight_m": 0.1, "lane_left_hindsight_std_m": 0.05, "step_hindsight_m": 0.002, "total_ms": 10.0}
WORST = 17
short, full = partial(outcome, report.main), partial(outcome, lambda argv: report.main([*argv, "--full"]))


def drive(path, later=LATER, worst=0.25, **columns):
    """Frames with errors by hindsight; one lane error is the worst."""
    frames = [row(k, lane_left_status="measured", lane_left_offset_m=1.7, **columns) for k in range(COUNT)]
    times = [dict(later) for _ in frames]
    if worst is not None:
        times[WORST]["lane_left_hindsight_m"] = worst
    return write(path, frames, times)


def test_without_truth_the_report_has_the_errors_by_hindsight_and_says_so(tmp_path, capsys):
    path = drive(tmp_path / "drive.metrics.parquet")
    _, text, _ = short(capsys, path, "--json", tmp_path / "report.json")
    assert "No frame has truth: the errors are by hindsight" in text
    assert "lane left at 10 m by hindsight, m" in text
    assert "frames with an error by hindsight, %: lane left 100.0" in text
    assert f"worst frame: lane left at 10 m by hindsight 0.250 m: roadperc-view {tmp_path}" in text
    (run,) = json.loads((tmp_path / "report.json").read_text())["runs"].values()
    found = run["stages"]["lane_left"]
    assert (found["column"], found["worst_frame"], found["answered"]) == ("lane_left_hindsight_m", WORST, 1.0)


def test_the_truth_of_one_output_does_not_hide_the_hindsight_of_another(tmp_path, capsys):
    path = drive(tmp_path / "drive.metrics.parquet", stereo_epe_px=0.4)
    _, text, _ = full(capsys, path)
    worst = text[text.index("Worst frames") :]
    assert "stereo_epe_px" in worst
    assert "lane_left_hindsight_m" in worst
    _, text, _ = short(capsys, path)
    assert "By hindsight, against what later frames found, without truth: lane_left_hindsight_m" in text


def test_truth_decides_and_the_full_report_tells_how_far_hindsight_can_be_believed(tmp_path, capsys):
    errors = np.random.default_rng(1).normal(0, 0.1, COUNT)
    rows = [row(k, lane_left_status="measured", lane_left_error_m=float(e)) for k, e in enumerate(errors)]
    times = [LATER | {"lane_left_hindsight_m": 2 * float(e)} for e in errors]
    path = write(tmp_path / "drive.metrics.parquet", rows, times)
    _, text, _ = short(capsys, path)
    assert "lane left error at 10 m, m" in text
    assert "lane left at 10 m by hindsight" not in text
    _, text, _ = full(capsys, path)
    line = next(line for line in text[text.index("\nHindsight") :].splitlines() if line.startswith("lane_left"))
    assert line.split() == ["lane_left_hindsight_m", "100.0", "1.00", "2.00", "2.00"]


def test_slices_of_objects_have_the_errors_by_hindsight_without_truth(tmp_path, capsys):
    path = drive(tmp_path / "drive.metrics.parquet")
    later = [0.5, -1.5, 0.1]
    columns = {"kept": [True] * 3, "label": ["Car", "Car", "Bus"], "frame": [0, 1, 2], "distance_m": [9.0] * 3}
    object_rows(columns | {"object_distance_hindsight_m": later}).write_parquet(tmp_path / "drive.objects.parquet")
    _, text, _ = short(capsys, path, "--by", "label")
    assert "error by hindsight of the distances" in text.replace("\n", " ")
    car = next(line for line in text.splitlines() if line.startswith("Car"))
    assert car.split()[-1] == "1.500"


@pytest.mark.parametrize(
    ("truth", "expected"), [({}, "failed"), ({"lane_left_error_m": 0.0}, "lane_left_hindsight_m mean: truth decides")]
)
def test_check_judges_hindsight_only_without_the_truth(tmp_path, capsys, truth, expected):
    criteria = tmp_path / "criteria.toml"
    criteria.write_text('[[criterion]]\nmetric = "lane_left_hindsight_m"\nstatistic = "mean"\nmost = 0.01\n')
    path = drive(tmp_path / "drive.metrics.parquet", **truth)
    assert expected in outcome(check.main, capsys, path, "--criteria", criteria)[1]


@pytest.mark.parametrize(("truth", "code"), [({}, 1), ({"lane_left_error_m": 0.01}, 0)])
def test_compare_judges_hindsight_only_without_the_truth(tmp_path, capsys, truth, code):
    base = drive(tmp_path / "base.metrics.parquet", worst=None, **truth)
    new = drive(tmp_path / "new.metrics.parquet", LATER | {"lane_left_hindsight_m": 0.4}, worst=None, **truth)
    found, text, _ = outcome(compare.main, capsys, base, new)
    assert found == code
    assert ("lane left at 10 m by hindsight" in text) == (not truth)


@pytest.mark.parametrize(("truth", "code"), [({}, 1), ({"time_to_impact_error_s": 0.1}, 0)])
def test_compare_judges_lost_times_to_impact_without_the_truth(tmp_path, capsys, truth, code):
    later = LATER | {"time_to_impact_hindsight_s": 0.1}
    base = drive(tmp_path / "base.metrics.parquet", later, worst=None, **truth)
    new = drive(tmp_path / "new.metrics.parquet", worst=None, **truth)
    found, text, _ = outcome(compare.main, capsys, base, new)
    assert found == code
    assert ("time to impact by hindsight coverage" in text) == (not truth)


def test_the_page_shows_the_claiming_and_the_finding_frame(tmp_path, capsys):
    path = drive(tmp_path / "drive.metrics.parquet", LATER | {"lane_left_hindsight_frame": 22.0})
    short(capsys, path, "--html", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert f"claimed: frame {WORST}" in page
    assert "found: frame 22" in page
