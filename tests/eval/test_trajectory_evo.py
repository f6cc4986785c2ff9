"""The errors equal those of evo, which runs as a separate program, because it is under the GPL.

``ROADPERC_EVO`` is the folder with ``evo_ape`` and ``evo_rpe`` from ``pip install evo``; without it the tests skip.
"""

import json
import os
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.cli.trajectory import main
from roadperc_stream.eval.runs import find_runs
from roadperc_stream.eval.trajectory.errors import Delta
from roadperc_stream.eval.trajectory.evaluation import evaluate
from roadperc_stream.eval.trajectory.poses import read_poses
from tests.eval.trajectory.paths import noisy, poses_at, scaled, write_run

pytestmark = pytest.mark.skipif(
    "ROADPERC_EVO" not in os.environ, reason="evo is not installed: ROADPERC_EVO names no folder with evo_ape, evo_rpe"
)

AGREEMENT = 1e-9
ALIGNED = {"se3": ["-a"], "sim3": ["-a", "-s"], "origin": ["--align_origin"], "none": []}
DELTAS = {"f": Delta(1, "frames"), "m": Delta(2.0, "metres")}
LOG = Path(__file__).parents[2] / "logs" / "sample.mcap"


def the_sample(path):
    log = path.with_name("drive.mcap")
    assert replay_main([str(LOG), str(log), "--only", "odometry", "--results-only", "--quiet"]) == 0


def a_car_that_stops(path):
    """Different speeds, a stop, hills, frames without a pose, and an unknown scale."""
    rng = np.random.default_rng(5)
    steps_m = np.where(np.arange(300) // 40 % 3 == 1, 0.0, rng.uniform(0.05, 1.5, 300))
    yaw = np.cumsum(rng.normal(0, 0.03, 300))
    places = np.cumsum(np.stack((steps_m * np.cos(yaw), steps_m * np.sin(yaw), 0.1 * steps_m), axis=1), axis=0)
    true = poses_at(places, np.outer(yaw, [0.01, 0.02, 1.0]))
    lost = ["lost" if k % 50 == 17 else "tracked" for k in range(300)]
    write_run(path, scaled(noisy(true, 2), 0.7), true, odometry_status=lost)


@pytest.fixture(scope="module", params=[the_sample, a_car_that_stops], ids=lambda make: make.__name__)
def drive(request, tmp_path_factory):
    """A folder with the exports of a run, and the run's poses."""
    folder = tmp_path_factory.mktemp(request.param.__name__)
    table = folder / "drive.metrics.parquet"
    request.param(table)
    assert main([str(table), "--export-tum", str(folder), "--export-kitti", str(folder)]) == 0
    (run,) = find_runs([str(table)])
    return folder, read_poses(run)


def evo_run(program, *arguments):
    """Run a program of evo."""
    folder = Path(os.environ["ROADPERC_EVO"])
    subprocess.run([folder / "python", folder / program, *arguments], check=True, capture_output=True, timeout=60)


def evo(program, kind, folder, *options):
    """evo's statistics of the exports of one kind."""
    saved = folder / "evo.zip"
    saved.unlink(missing_ok=True)
    files = [str(folder / f"drive.{of}.{kind}") for of in ("true", "est")]
    evo_run(program, kind, *files, *options, "--save_results", str(saved))
    with zipfile.ZipFile(saved) as archive:
        return json.loads(archive.read("stats.json"))


def agree(ours, theirs):
    same = {"rmse": ours.rmse, "mean": ours.mean, "median": ours.median, "std": ours.std, "sse": ours.sse}
    assert theirs == pytest.approx(same | {"min": ours.least, "max": ours.most}, abs=AGREEMENT, rel=0)


@pytest.mark.parametrize("alignment", ALIGNED)
def test_ate(drive, alignment):
    folder, run = drive
    found = evaluate(run, alignment, DELTAS["f"])
    agree(found.absolute_m, evo("evo_ape", "tum", folder, *ALIGNED[alignment]))


@pytest.mark.parametrize(("unit", "alignment"), [("f", "se3"), ("m", "none"), ("m", "sim3")])
def test_rpe(drive, unit, alignment):
    folder, run = drive
    found = evaluate(run, alignment, DELTAS[unit])
    assert found.relative_m.count > 20
    pairing = ["--delta", str(DELTAS[unit].size), "--delta_unit", unit, "--all_pairs", *ALIGNED[alignment]]
    agree(found.relative_m, evo("evo_rpe", "tum", folder, *pairing, "-r", "trans_part"))
    agree(found.relative_deg, evo("evo_rpe", "tum", folder, *pairing, "-r", "angle_deg"))


def test_kitti_files_give_the_same_errors(drive):
    folder, run = drive
    found = evaluate(run, "origin", DELTAS["f"])
    agree(found.absolute_m, evo("evo_ape", "kitti", folder))
    every_frame = ["--delta", "1", "--delta_unit", "f", "--all_pairs"]
    agree(found.relative_m, evo("evo_rpe", "kitti", folder, *every_frame))
    agree(found.relative_deg, evo("evo_rpe", "kitti", folder, *every_frame, "-r", "angle_deg"))
