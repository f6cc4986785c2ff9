"""Accuracy and coverage of the chain on rendered logs with truth.

``make accuracy-long`` runs the long forms at full size and with several seeds; `make test-long` runs short forms.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import polars as pl
import pytest

from roadperc_stream.cli import convert, render
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.eval.report.lag import correlations, lag_frames
from roadperc_stream.output.tables import sidecar_path

pytestmark = pytest.mark.long

BEND = ("--scene", "bend", "--weave", "0.5")
NOISE = ("--tag-noise", "0.02", "--depth-noise", "0.01")
SHORT = ("--size", "640x480", "--seconds", "1", "--without", "right")


def long(*options):
    """Options of a scene at full size."""
    return pytest.param(options, marks=pytest.mark.accuracy)


@dataclass(frozen=True)
class Run:
    metrics: pl.DataFrame

    def errors(self, column):
        """Absolute errors of a column, and their coverage."""
        values = self.metrics[column]
        return values.drop_nulls().abs().to_numpy(), 1 - values.null_count() / len(values)

    def jitter(self, column):
        """Standard deviation of the second difference over frames with values."""
        return float(np.nanstd(np.diff(self.metrics[column].to_numpy().astype(float), 2)))

    def lag(self, side):
        """Lag of the smoothed offset behind the truth, in frames."""
        columns = correlations(f"lane_{side}_offset_m", f"lane_{side}_true_offset_m")
        return lag_frames(self.metrics.select(columns).item().to_list())


def replayed(folder, *arguments):
    """The metrics of the folder's log, replayed with these arguments."""
    assert replay_main([str(folder / "in.mcap"), str(folder / "out.mcap"), "--quiet", "--force", *arguments]) == 0
    return Run(pl.read_parquet(sidecar_path(folder / "out.mcap", "metrics")))


def rendered(folder, *options):
    """The metrics of a rendered scene; its log stays in the folder."""
    assert render.main([str(folder / "dump"), *options]) == 0
    assert convert.main([str(folder / "dump"), str(folder / "in.mcap"), "--quiet"]) == 0
    return replayed(folder)


@pytest.fixture(scope="module")
def noisy_bend(tmp_path_factory):
    """The folder and metrics of the noisy bend with given options, rendered once."""

    @cache
    def bend(options):
        folder = tmp_path_factory.mktemp("bend")
        return folder, rendered(folder, *BEND, *NOISE, *options)

    return bend


@pytest.mark.parametrize("options", [SHORT, *(long("--seed", str(seed)) for seed in (0, 1, 2))])
def test_ego_lane_and_surface_on_the_noisy_bend(noisy_bend, options):
    _, run = noisy_bend(options)
    for side in ("left", "right"):
        error, coverage = run.errors(f"lane_{side}_error_m")
        assert coverage >= 0.95
        assert np.median(error) < 0.05
        assert np.quantile(error, 0.95) < 0.15
        smoothed = run.jitter(f"lane_{side}_offset_m")
        assert smoothed < 0.015
        assert smoothed <= run.jitter(f"lane_{side}_raw_offset_m") / 3
        assert options == SHORT or abs(run.lag(side)) <= 1, "the short log is too short for the lag"
    angle, coverage = run.errors("surface_angle_error_deg")
    assert coverage >= 0.95
    assert np.median(angle) < 0.1
    assert options != SHORT or run.errors("drivable_iou")[0].min() > 0.9


@pytest.mark.parametrize(
    "options",
    [
        ("--size", "640x480", "--seconds", "2.5", "--seed", "610", "--without", "right"),
        pytest.param((), marks=pytest.mark.accuracy),
    ],
)
def test_odometry_improves_the_lanes(noisy_bend, options):
    folder, run = noisy_bend(options)
    without = replayed(folder, "--set", "lanes.use_odometry=false", "--only", "surface,lanes")
    for side in ("left", "right"):
        error, _ = run.errors(f"lane_{side}_error_m")
        worse, _ = without.errors(f"lane_{side}_error_m")
        assert np.quantile(error, 0.95) < np.quantile(worse, 0.95)
        assert run.jitter(f"lane_{side}_offset_m") < without.jitter(f"lane_{side}_offset_m") / 1.5


@pytest.mark.parametrize("options", [
    ("--scene", "straight", "--size", "640x480", "--seconds", "0.3", "--without", "right"),
    *(long("--scene", scene, "--seconds", "2") for scene in ("straight", "bend")),
])  # fmt: skip
def test_surface_without_noise(tmp_path, options):
    run = rendered(tmp_path, *options)
    angle, coverage = run.errors("surface_angle_error_deg")
    assert (np.median(angle) < 0.02, coverage) == (True, 1.0)
    assert "640x480" not in options or run.errors("camera_height_error_m")[0].max() < 0.005


def test_frames_with_dropped_sensors_use_the_other_inputs(tmp_path):
    run = rendered(tmp_path, "--scene", "straight", "--drop", "0.3", "--size", "320x240", "--seconds", "0.6")
    table = run.metrics
    missing = table["missing"].to_list()
    assert 0 < sum("depth" in roles for roles in missing) < len(missing)
    for row, roles in zip(table.iter_rows(named=True), missing, strict=True):
        without_pair = "right" in roles
        expected = "held" if without_pair else "stereo"
        if "depth" not in roles:
            expected = "lower_image" if "segmentation" in roles else "depth"
        elif not without_pair and "segmentation" in roles:
            expected = "lower_image"
        assert row["surface_source"] == expected, "stereo replaces depth, the held plane replaces both"
        assert (row["lane_left_status"] == "measured") <= ("segmentation" not in roles)
