"""Logs with several segments: each is evaluated like a separate log, and no value spans two segments."""

from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream.cli.report import main as report_main
from roadperc_stream.cli.trajectory import main
from roadperc_stream.eval.compare.fields import compare_tables
from roadperc_stream.eval.compare.pairing import logged_runs, pair_runs
from roadperc_stream.eval.html.charts import POSE_COLUMNS, paths, trajectory
from roadperc_stream.eval.html.figures import load_series
from roadperc_stream.eval.options import Rules
from roadperc_stream.eval.trajectory.errors import Delta
from roadperc_stream.eval.trajectory.evaluation import evaluate
from roadperc_stream.eval.trajectory.poses import read_poses
from tests.eval.tables import START_NS, STEP_NS, row, run_of, summary_of, write
from tests.eval.trajectory.paths import helix, noisy, rigid, scaled, straight, write_run

FRAMES = 24
RUN = Delta(1, "frames")


def offsets(frame):
    """The smoothed, raw and true offsets of a boundary; the smoothed one lags two frames."""
    true = [1.5 + 0.2 * np.sin((frame - lag) / 3) + 0.1 * np.sin((frame - lag) / 1.3) for lag in (0, 2)]
    names = ("lane_left_true_offset_m", "lane_left_offset_m", "lane_left_raw_offset_m")
    return dict(zip(names, (*map(float, true), float(true[1]) + 0.01 * (-1) ** frame), strict=True))


def drive(frames=FRAMES):
    return [row(k, **offsets(k)) for k in range(frames)]


def again(rows, segment=1):
    """The same frames in another segment, as from a bag played in a loop."""
    return [replace(item, frame=item.frame + len(rows) * segment, segment=segment) for item in rows]


@pytest.fixture
def once(tmp_path):
    return summary_of(run_of(write(tmp_path / "once.metrics.parquet", drive())), worst=3)


@pytest.fixture
def looped(tmp_path):
    return write(tmp_path / "loop.metrics.parquet", [*drive(), *again(drive())])


def test_a_looped_log_has_twice_the_values_and_the_same_statistics(once, looped):
    found = summary_of(run_of(looped), worst=3)
    assert (once.segments, found.segments) == (1, 2)
    assert found.span_s == 2 * once.span_s == pytest.approx(2 * 0.05 * (FRAMES - 1))
    assert (found.longest_gap_s, found.rate_hz) == (once.longest_gap_s, pytest.approx(once.rate_hz))
    for kind in ("", "raw_"):
        one, two = (s.statistics[f"lane_left_{kind}second_difference_m"] for s in (once, found))
        assert (two.values, two.std) == (2 * one.values, pytest.approx(one.std, rel=1e-12))
        assert one.values == FRAMES - 2
    assert found.lag_frames("left") == once.lag_frames("left") == 2


def test_the_time_of_worst_frames_continues_across_segments(tmp_path):
    rows = [*drive(3), *again(drive(3))]
    rows[4] = replace(rows[4], lane_left_error_m=0.7)
    rows[1] = replace(rows[1], lane_left_error_m=0.7)
    found = summary_of(run_of(write(tmp_path / "a.metrics.parquet", rows)), worst=3).worst["lane_left_error_m"]
    places = [(f.frame, f.segment, pytest.approx(f.since_start_s)) for f in found]
    assert places == [(1, 0, 0.05), (4, 1, 0.15)]
    assert found[0].stamp_ns == found[1].stamp_ns


def test_the_report_counts_segments_and_curves_are_interrupted_between_them(looped, capsys):
    assert report_main([str(looped), "--full"]) == 0
    assert "48 frames in 2 segments over 2.30 s, 20.0 frames/s, longest gap 0.05 s" in capsys.readouterr().out
    found = load_series(run_of(looped), ["lane_left_offset_m"])
    values = found.values["lane_left_offset_m"]
    assert len(values) == len(found.since_start_s) == len(found.segments) == 2 * FRAMES + 1
    assert np.flatnonzero(np.isnan(values)).tolist() == [FRAMES]
    assert (np.diff(found.since_start_s) >= 0).all()
    assert found.since_start_s[-1] == pytest.approx(2 * 0.05 * (FRAMES - 1))


def looped_run(path, passes, **others):
    """A table of odometry in segments, from the (estimated, true) poses of each."""
    estimated, true = (np.concatenate(side) for side in zip(*passes, strict=True))
    lengths = [len(one) for one, _ in passes]
    stamps = [START_NS + k * STEP_NS for length in lengths for k in range(length)]
    segments = [number for number, length in enumerate(lengths) for _ in range(length)]
    return write_run(path, estimated, true, **{"stamp_ns": stamps, "segment": segments, **others})


@pytest.fixture
def one_pass():
    return noisy(helix(60), 3), rigid(1) @ helix(60)


def evaluated(path, alignment=None):
    return evaluate(read_poses(run_of(path)), alignment, RUN)


def test_each_segment_of_a_looped_log_is_evaluated_like_a_separate_log(tmp_path, one_pass):
    single = evaluated(write_run(tmp_path / "single.metrics.parquet", *one_pass))
    found = evaluated(looped_run(tmp_path / "loop.metrics.parquet", [one_pass] * 3))
    assert found.driven_m == pytest.approx(3 * single.driven_m)
    for name in ("absolute_m", "relative_m", "relative_deg"):
        one, three = getattr(single, name), getattr(found, name)
        assert (three.count, three.rmse, three.most) == (3 * one.count, pytest.approx(one.rmse), one.most)
    assert [s.count for s in found.stretches] == [3 * s.count for s in single.stretches]
    assert found.together.translation_percent == pytest.approx(single.together.translation_percent)
    assert found.together.length_m is None
    assert found.every == single.every == 1, "three segments of 42 m are not one of 100 m"


def test_segments_are_aligned_separately(tmp_path):
    """Two segments in two odom frames and at two scales: both fit the truth exactly."""
    passes = [(rigid(1) @ scaled(helix(40), 0.5), helix(40)), (rigid(2) @ helix(30), rigid(3) @ helix(30))]
    found = evaluated(looped_run(tmp_path / "a.metrics.parquet", passes), "sim3")
    assert found.scales == (pytest.approx(2.0), pytest.approx(1.0))
    assert found.absolute_m.most < 1e-9
    assert found.relative_m.most < 1e-9


def test_a_segment_that_is_too_short_is_left_out_with_a_note(tmp_path, one_pass, capsys):
    short = tuple(side[:2] for side in one_pass)
    path = looped_run(tmp_path / "loop.metrics.parquet", [one_pass, short])
    found = evaluated(path)
    assert found.absolute_m.count == 60
    assert len(found.scales) == 1
    expected = "no errors of segment 1: expected 3 or more frames with an estimated and a true pose, found 2"
    assert found.left_out == (expected,)
    assert main([str(path)]) == 0
    text = capsys.readouterr().out
    assert expected in text
    assert "loop: 62 frames in 2 segments of the log" in text
    assert "aligned by SE(3), each segment of the log separately" in text


def test_each_segment_has_exported_files(tmp_path, one_pass):
    path = looped_run(tmp_path / "loop.metrics.parquet", [one_pass, one_pass])
    single = write_run(
        tmp_path / "one.metrics.parquet", *one_pass, stamp_ns=[START_NS + k * STEP_NS for k in range(60)]
    )
    folder = tmp_path / "files"
    arguments = ["--export-tum", str(folder), "--export-kitti", str(folder)]
    assert main([str(path), str(single), *arguments]) == 0
    names = sorted(item.name for item in folder.iterdir())
    kinds = ("est.kitti", "est.tum", "true.kitti", "true.tum")
    assert names == [f"{run}.{kind}" for run in ("loop.segment-0", "loop.segment-1", "one") for kind in kinds]
    for kind in kinds:
        first, second, alone = (
            (folder / f"{run}.{kind}").read_text() for run in ("loop.segment-0", "loop.segment-1", "one")
        )
        assert first == second == alone


def test_the_trajectory_chart_starts_each_segment_at_the_origin(tmp_path):
    path = looped_run(tmp_path / "loop.metrics.parquet", [(straight(5, 1.0), straight(5, 1.0))] * 2)
    series = load_series(run_of(path), POSE_COLUMNS)
    found = paths(series)
    for points_m in found.values():
        assert points_m[:, 0].tolist() == pytest.approx([0, 1, 2, 3, 4, np.nan, 0, 1, 2, 3, 4], nan_ok=True)
    figure = next(trajectory([series], [found]))
    assert "Each segment of a log begins at the origin." in figure.note
    assert all(trace["y"][5] is None for trace in figure.traces[:2])


def pair(tmp_path, reference, candidate):
    sides = [
        logged_runs(str(write(tmp_path / f"{name}.metrics.parquet", rows)))
        for name, rows in (("reference", reference), ("candidate", candidate))
    ]
    (found,) = pair_runs(*sides, other_log=False).pairs
    return found


def test_frames_of_equal_stamps_pair_within_their_segment(tmp_path):
    """The candidate lacks a frame of the first segment; the frame of the second segment does not replace it."""
    rows = [replace(item, lane_left_offset_m=float(item.frame)) for item in [*drive(5), *again(drive(5))]]
    found = pair(tmp_path, rows, [*rows[:2], *rows[3:]])
    assert found.by_segment
    frames, columns = compare_tables(found, Rules())
    assert (frames.common, frames.only_base, frames.only_new) == (9, 1, 0)
    assert {agreement.state for agreement in columns.values()} == {"identical"}


def test_runs_with_different_numbers_of_segments_pair_by_stamp(tmp_path):
    """As with a table of a version without segments."""
    rows = [*drive(4), *again(drive(4))]
    found = pair(tmp_path, [replace(item, segment=0) for item in rows], rows)
    assert not found.by_segment
    assert compare_tables(found, Rules())[0].common == 8
