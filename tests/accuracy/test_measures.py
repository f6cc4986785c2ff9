"""The computation of the figures on tables with known answers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from roadperc_stream.tools.scene.job import render_dump
from tests.accuracy import measures
from tests.accuracy.drives import Noise, depth_of, drive, with_noise
from tests.accuracy.running import Replayed

STEP_NS = 100_000_000


def lanes(statuses, errors_m, changes):
    """A table of frames at 10 Hz with these values of the left boundary and a right boundary without error."""
    n = len(statuses)
    offsets = {"left": [1.75 + e for e in errors_m], "right": [-1.75] * n}
    return pl.DataFrame(
        {
            "stamp_ns": [k * STEP_NS for k in range(n)],
            "true_lane_changes": changes,
            "reason_codes": [[]] * n,
            "lane_left_status": statuses,
            "lane_right_status": ["measured"] * n,
            **{f"lane_{side}_offset_m": values for side, values in offsets.items()},
            "lane_left_error_m": errors_m,
            "lane_right_error_m": [0.0] * n,
            "lane_left_true_offset_m": [1.75] * n,
            "lane_right_true_offset_m": [-1.75] * n,
        },
        schema_overrides={"reason_codes": pl.List(pl.String), "true_lane_changes": pl.Int64},
    )


def replayed(frames=None, objects=None):
    return Replayed("drive", 0, Path("drive"), frames, objects)


def test_frames_within_three_tenths_of_a_second_of_a_crossing_are_left_out():
    frames = lanes(["measured"] * 10, [9.0] * 10, [0] * 5 + [1] * 5)
    assert measures.crossings_ns(frames).tolist() == [5 * STEP_NS]
    away = measures.away_from(frames["stamp_ns"].to_numpy(), [5 * STEP_NS])
    assert np.flatnonzero(~away).tolist() == [2, 3, 4, 5, 6, 7, 8]
    assert len(measures.boundaries([replayed(frames)]).at_car_m) == 2 * 3
    unchanged = lanes(["measured"] * 4, [0.0] * 4, [None] * 4)
    assert measures.boundaries([replayed(unchanged)]).coverage == 1.0


def test_only_measured_boundaries_have_errors_and_the_others_cost_coverage():
    frames = lanes(["measured", "held", "lost", "measured"], [0.1, 5.0, 5.0, -0.5], [0] * 4)
    found = measures.boundaries([replayed(frames)])
    assert found.coverage == 6 / 8
    assert measures.share_above(found.at_car_m, 0.3) == 1 / 6
    assert measures.share_above(found.ahead_m, 0.3) == 1 / 6
    assert measures.quantile(found.at_car_m, 1.0) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("status", "right_from", "expected"),
    [("measured", 5, True), ("measured", 8, True), ("measured", 9, False), ("held", 5, False)],
)
def test_a_lane_is_handed_over_in_time(status, right_from, expected):
    errors_m = [0.0] * 5 + [3.5] * (right_from - 5) + [0.0] * (12 - right_from)
    assert measures.handed_over(lanes([status] * 12, errors_m, [0] * 5 + [1] * 7)) == [expected]


def test_lanes_of_wrong_width_or_beside_the_car_are_implausible():
    frames = lanes(["measured"] * 4 + ["lost"], [0.0, -1.6, 4.0, -3.0, -3.0], [0] * 5)
    assert measures.implausible(frames).tolist() == [False, True, True, True]


def test_an_absent_boundary_needs_a_reason_of_the_lane_stage():
    frames = lanes(["lost", "held", None, "measured"], [0.0] * 4, [0] * 4)
    codes = [["lanes.boundary_lost"], [], ["stereo.no_right_image"], []]
    assert measures.absent_without_reason(frames.with_columns(reason_codes=pl.Series(codes))).tolist() == [False, True]


def test_rows_of_one_object_are_not_independent():
    """Two cars, one always wrong: by rows the interval is narrow, by cars it is wide."""
    wrong = np.repeat([True, False], 40)
    share, low, high = measures.share_by_object(wrong, np.repeat([0, 1], 40))
    assert (share, low, high) == (0.5, 0.0, 1.0)
    share, low, high = measures.share_by_object(wrong, np.arange(80))
    assert share == 0.5
    assert low == pytest.approx(0.39, abs=0.015)  # binomial: 0.5 - 1.96 sqrt(0.25 / 80)
    assert high == pytest.approx(0.61, abs=0.015)


def test_equal_track_numbers_of_two_replays_are_two_objects():
    table = pl.DataFrame(
        {"kept": [True, True, False], "track_id": ["1", "1", "1"], "distance_m": [9.0, None, 9.0],
         "distance_std_m": [0.1, None, 0.1], "true_distance_m": [9.0, 25.0, 9.0]}
    )  # fmt: skip
    rows = measures.kept_true([replayed(objects=table), replayed(objects=table)], 0, 20)
    assert rows["object"].to_list() == [0, 1]


def test_the_visible_share_is_that_of_the_areas_of_equal_objects():
    seen = pl.DataFrame({"frame": [0, 0, 1], "true_distance_m": [9.0, 20.0, None], "x_min_px": [0.0, 5.0, 0.0],
                         "x_max_px": [4.0, 9.0, 9.0], "y_min_px": [0.0] * 3, "y_max_px": [5.0] * 3})  # fmt: skip
    whole = seen.with_columns(x_max_px=pl.Series([8.0, 9.0, 9.0]), frame=pl.Series([0, 3, 1]))
    assert measures.with_visible_share([replayed(objects=seen), replayed(objects=whole)])["visible"].to_list() == [0.5]


def test_an_alarm_without_a_true_impact_is_false():
    frames = pl.DataFrame(
        {"time_to_impact_s": [1.0, 1.0, 1.0, None, 1.6], "true_time_to_impact_s": [None, 1.9, 2.1, None, 9.0]}
    )
    assert measures.false_alarms(frames).tolist() == [True, True, False, False]
    assert measures.impacts([replayed(frames)]).tolist() == [[1.0, 1.9], [1.0, 2.1]]


def test_added_noise_equals_rendered_noise(tmp_path):
    options = drive("straight", scene="straight", width=160, height=120, seconds=0.2).options
    render_dump(tmp_path / "clean", replace(options, seed=3), force=False, on_frame=lambda: None)
    noisy = replace(options, seed=3, tag_noise=0.05, depth_noise=0.02)
    render_dump(tmp_path / "rendered", noisy, force=False, on_frame=lambda: None)
    with_noise(tmp_path / "clean", tmp_path / "made", 3, Noise(0.05, 0.02))
    rendered, made = (
        {str(path.relative_to(tmp_path / name)): path for path in (tmp_path / name).rglob("*") if path.is_file()}
        for name in ("rendered", "made")
    )
    assert rendered.keys() == made.keys()
    for name, path in rendered.items():
        if name.startswith("depth"):
            assert np.abs(depth_of(path) - depth_of(made[name])).max() < 2e-4
        else:
            assert path.read_bytes() == made[name].read_bytes(), name
