"""The commands' output for tables with known numbers equals its recording.

After an intended change, ``pytest tests/eval/test_recorded.py --force-regen`` replaces the recordings.
"""

from pathlib import Path

import numpy as np
import pytest

from roadperc_stream.model import Reason
from tests.eval.dataset.datasets import small_dataset
from tests.eval.tables import row, write
from tests.eval.trajectories.paths import helix, noisy, rigid, scaled, write_run
from tests.sessions import repeated

FRAMES = 120


def drive(path, seed):
    """A table with values in every kind of column, some of them missing."""
    random = np.random.default_rng(seed)
    rows, times = [], []
    for k in range(FRAMES):
        offsets_m = 1.7 + 0.1 * np.sin(k / 20) + random.normal(0, 0.02, 3)
        columns = {
            "surface_source": "depth" if k % 7 else "assumed",
            "surface_inlier_ratio": 0.9 + random.normal(0, 0.02),
            "camera_height_error_m": random.normal(0.01, 0.02),
            "lane_left_status": ("measured", "held", "lost")[min(k % 20 // 9, 2)],
            "lane_left_offset_m": offsets_m[0],
            "lane_left_raw_offset_m": offsets_m[1],
            "lane_left_true_offset_m": 1.7 + 0.1 * np.sin(k / 20),
            "lane_left_error_m": offsets_m[2] - 1.7,
            "lane_right_status": "measured",
            "lane_right_boundary_class": "road" if k % 3 else "sidewalk",
            "lane_right_offset_m": -np.sin((k - 2) / 5),
            "lane_right_true_offset_m": -np.sin(k / 5),
            "drivable_iou": 0.9 + random.normal(0, 0.02),
            "filter_tp": 3,
            "filter_fp": k % 2,
            "filter_fn": 1,
            "nearest_object_m": 5.0 + k / 10 if k % 11 else None,
            "object_distance_error_m": abs(random.normal(0, 0.5)),
            "detections": 5,
            "detections_kept": int(random.integers(3, 6)),
            "odometry_status": "tracked" if k else "first",
            "step_m": 0.5 + random.normal(0, 0.01),
            "step_error_m": abs(random.normal(0, 0.01)),
            "odom_x_m": 0.5 * k,
            "odom_y_m": random.normal(0, 0.1),
            "true_x_m": 0.5 * k,
            "true_y_m": 0.0,
            "missing": ["depth"] if not k % 7 else [],
            "reasons": [Reason("surface", "no_depth")] if not k % 7 else [],
        }
        rows.append(row(k, **columns))
        times.append({"total_ms": 40.0 + random.exponential(5.0), "lanes_ms": 8.0 + random.exponential(1.0)})
    return write(path, rows, times)


@pytest.fixture
def runs(tmp_path):
    names = ("one", "other", "third")
    return [str(drive(tmp_path / f"{name}.metrics.parquet", seed)) for seed, name in enumerate(names)]


@pytest.fixture
def tables(runs, tmp_path):
    """Drives, paths with and without scale and truth, and a dataset."""
    small_dataset(tmp_path / "dataset")
    (tmp_path / "paths").mkdir()
    write_run(tmp_path / "paths" / "long.metrics.parquet", rigid(1) @ noisy(helix(400), 1), helix(400))
    write_run(tmp_path / "paths" / "mono.metrics.parquet", scaled(helix(60), 0.5), helix(60), step_m=[None] * 60)
    write_run(tmp_path / "paths" / "blind.metrics.parquet", helix(60))


def test_a_session_equals_its_recording(tables, tmp_path, capsys, monkeypatch, file_regression):
    session = Path(__file__).with_name("sessions") / "tables.txt"
    file_regression.check(repeated(session, tmp_path, capsys, monkeypatch), fullpath=session)
