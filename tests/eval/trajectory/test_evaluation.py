"""Errors of a run: lengths, alignment, and runs that cannot be evaluated."""

import dataclasses

import numpy as np
import pytest

from roadperc_stream.errors import TableError
from roadperc_stream.eval.trajectory.errors import Delta
from roadperc_stream.eval.trajectory.evaluation import evaluate
from roadperc_stream.eval.trajectory.poses import RunPoses
from tests.eval.trajectory.paths import helix, scaled, straight

FRAME = Delta(1, "frames")


def run_of(estimated, true, **facts):
    frames = len(estimated)
    stamps_ns, segments = np.arange(frames), np.zeros(frames, np.int64)
    poses = (stamps_ns, estimated, true, segments)
    found = RunPoses("drive", "drive.metrics.parquet", frames, 0, frames, frames, frames - 1, 0, *poses)
    return dataclasses.replace(found, **facts)


def test_long_paths_are_evaluated_over_kittis_lengths():
    """250 m in steps of 1 m, a stretch at every tenth frame: 15 of 100 m and 5 of 200 m."""
    found = evaluate(run_of(scaled(straight(251, 1.0), 1.01), straight(251, 1.0)), None, FRAME)
    assert (found.driven_m, found.every) == (pytest.approx(250), 10)
    assert [(s.length_m, s.count) for s in found.stretches][:3] == [(100, 15), (200, 5), (300, 0)]
    assert [s.length_m for s in found.stretches] == [100, 200, 300, 400, 500, 600, 700, 800]
    first, second, third = found.stretches[:3]
    assert first.translation_percent == pytest.approx(1.01)
    assert second.translation_percent == pytest.approx(1.005)
    assert third.translation_percent is None
    assert found.together.translation_percent == pytest.approx((15 * 1.01 + 5 * 1.005) / 20)
    exactly_100_m = straight(101, 1.0)
    assert evaluate(run_of(exactly_100_m, exactly_100_m), None, FRAME).every == 1


def test_a_run_without_scale_is_aligned_by_sim3_by_default():
    small = run_of(scaled(helix(60), 0.1), helix(60), without_scale=59)
    assert evaluate(small, None, FRAME).alignment == "sim3"
    assert evaluate(small, None, FRAME).absolute_m.rmse < 1e-12
    assert evaluate(small, None, FRAME).relative_m.rmse < 1e-12
    assert evaluate(small, "se3", FRAME).absolute_m.rmse > 1
    metric = run_of(helix(60), helix(60), without_scale=20)
    assert evaluate(metric, None, FRAME).alignment == "se3"


def test_a_delta_longer_than_the_path_has_no_pairs():
    found = evaluate(run_of(helix(10), helix(10)), None, Delta(50.0, "metres"))
    assert (found.relative_m, found.relative_deg) == (None, None)
    assert found.absolute_m.count == 10


@pytest.mark.parametrize(
    ("run", "said"),
    [
        (
            run_of(helix(9), None),
            "drive.metrics.parquet: no errors without truth: none of 9 frames has a true pose",
        ),
        (run_of(helix(2), helix(2), frames=9), "expected 3 or more frames with an estimated and a true pose, found 2"),
        (run_of(straight(9, 0), helix(9), without_scale=8), r"drive.metrics.parquet: no Sim\(3\) alignment"),
    ],
)
def test_runs_that_cannot_be_evaluated_are_errors(run, said):
    with pytest.raises(TableError, match=said):
        evaluate(run, None, FRAME)
