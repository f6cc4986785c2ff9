"""roadperc-trajectory: its output, its files, and its exit code."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from roadperc_stream.cli import report
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.cli.trajectory import main
from roadperc_stream.eval.runs import find_runs
from roadperc_stream.eval.trajectory.errors import Delta
from roadperc_stream.eval.trajectory.evaluation import evaluate
from roadperc_stream.eval.trajectory.poses import read_poses
from tests.eval.tables import outcome
from tests.eval.trajectory.paths import helix, noisy, write_run

trajectory = partial(outcome, main)

TRUE = helix(60)
SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"


@pytest.fixture
def shifted(tmp_path):
    """Poses 3 m to the left and 4 m up; one frame has no truth, one is lost."""
    estimated = TRUE.copy()
    estimated[:, :3, 3] += [0.0, 3.0, 4.0]
    status = ["first", "lost"] + ["tracked"] * 58
    true_x_m = [None if k == 7 else x for k, x in enumerate(TRUE[:, 0, 3])]
    path = tmp_path / "drive.metrics.parquet"
    return write_run(path, estimated, TRUE, odometry_status=status, true_x_m=true_x_m)


def test_exports_of_runs_with_and_without_truth(tmp_path, shifted, capsys):
    folder = tmp_path / "paths"
    code, _, _ = trajectory(capsys, shifted, "--export-tum", folder, "--export-kitti", folder)
    assert code == 0
    assert sorted(p.name for p in folder.iterdir()) == [
        f"drive.{kind}.{suffix}" for kind in ("est", "true") for suffix in ("kitti", "tum")
    ]
    shapes = {p.name: np.loadtxt(p).shape for p in folder.iterdir()}
    assert shapes == {name: (58, 12 if name.endswith("kitti") else 8) for name in shapes}
    assert (folder / "drive.est.tum").read_text().startswith("1577836800.123456789 0.0 3.0 4.0 ")
    blind = write_run(tmp_path / "blind.metrics.parquet", TRUE)
    code, text, _ = trajectory(capsys, blind, "--export-tum", tmp_path / "other")
    assert code == 0
    assert "no errors without truth" in text
    assert [p.name for p in (tmp_path / "other").iterdir()] == ["blind.est.tum"]


def test_runs_of_equal_names_are_exported_into_their_folders(tmp_path, capsys):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_run(tmp_path / folder / "drive.metrics.parquet", noisy(TRUE, 1), TRUE)
    code, _, _ = trajectory(capsys, tmp_path / "a", tmp_path / "b", "--export-kitti", tmp_path / "paths")
    assert code == 0
    found = sorted(p.relative_to(tmp_path / "paths").as_posix() for p in (tmp_path / "paths").rglob("*.kitti"))
    assert found == [f"{folder}/drive.{kind}.kitti" for folder in "ab" for kind in ("est", "true")]


def test_a_folder_that_cannot_be_written_is_an_error(shifted, capsys):
    code, _, err = trajectory(capsys, shifted, "--export-tum", shifted)
    assert code == 1
    assert err == f"error: {shifted}/drive.est.tum: File exists\n"


def test_without_truth_and_export_the_error_is_one_line(tmp_path, capsys):
    code, text, err = trajectory(capsys, write_run(tmp_path / "blind.metrics.parquet", TRUE))
    assert (code, text) == (1, "")
    assert err.startswith(f"error: {tmp_path}/blind.metrics.parquet: no errors without truth: none of 60 frames")
    assert err.count("\n") == 1


def test_the_errors_on_the_sample_equal_those_in_the_docs(tmp_path):
    log = tmp_path / "sample.mcap"
    assert replay_main([str(SAMPLE), str(log), "--only", "odometry", "--results-only", "--quiet"]) == 0
    found = evaluate(read_poses(*find_runs([str(log)])), None, Delta(1, "frames"))
    assert found.driven_m == pytest.approx(19.5, abs=0.05)
    assert (found.run.coverage, found.run.up_to_scale) == (1.0, False)
    assert found.absolute_m.rmse == pytest.approx(0.009, abs=0.001)
    assert found.relative_m.rmse == pytest.approx(0.002, abs=0.0005)
    assert found.relative_deg.rmse == pytest.approx(0.009, abs=0.001)
    assert found.together.translation_percent == pytest.approx(0.18, abs=0.02)
    assert found.together.rotation_deg_per_100m == pytest.approx(0.33, abs=0.03)


@pytest.mark.parametrize(("frames", "kitti"), [(60, True), (4, False)])
def test_the_report_of_a_run_has_the_errors_of_its_path_in_one_line(tmp_path, capsys, frames, kitti):
    path = write_run(
        tmp_path / "drive.metrics.parquet", noisy(TRUE, 1)[:frames], TRUE[:frames], turn_error_deg=[0.1] * frames
    )
    assert report.main([str(path), "--json", str(tmp_path / "report.json")]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("trajectory: ATE ")]
    assert ("KITTI t_err " in line) == kitti
    (found,) = json.loads((tmp_path / "report.json").read_text())["runs"].values()
    assert f"ATE {found['trajectory']['ate_m']['rmse']:.4f} m, aligned by SE(3)" in line
