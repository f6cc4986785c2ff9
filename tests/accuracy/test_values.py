"""The computation of the values on tables with known answers."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from roadperc_stream.tools.scene.job import render_dump
from tests.accuracy import values
from tests.accuracy.bounds import Measured, Value, nothing
from tests.accuracy.drives import Noise, depth_of, drive, with_noise
from tests.accuracy.values import Tables
from tests.eval.tables import row, write

STEP_NS = 100_000_000


def frames(replay=0, **columns):
    return Tables(pl.DataFrame(columns).with_columns(replay=pl.lit(replay)), None)


def objects(*replays):
    rows = [pl.DataFrame(columns).with_columns(replay=pl.lit(k), seed=pl.lit(0)) for k, columns in enumerate(replays)]
    return Tables(None, pl.concat(rows))


def lanes(statuses, errors_m, changes, **more):
    """Frames at 10 Hz with these values of the left boundary and a right boundary without error."""
    n = len(statuses)
    columns = {
        "stamp_ns": [k * STEP_NS for k in range(n)],
        "true_lane_changes": pl.Series(changes, dtype=pl.Int64),
        "lane_left_status": statuses,
        "lane_right_status": ["measured"] * n,
        "lane_left_offset_m": [1.75 + e for e in errors_m],
        "lane_right_offset_m": [-1.75] * n,
        "lane_left_error_m": errors_m,
        "lane_right_error_m": [0.0] * n,
        "lane_left_true_offset_m": [1.75] * n,
        "lane_right_true_offset_m": [-1.75] * n,
    }
    return frames(**columns, **more)


def test_frames_within_three_tenths_of_a_second_of_a_crossing_are_left_out():
    tables = lanes(["measured"] * 10, [9.0] * 10, [0] * 5 + [1] * 5)
    assert values.crossings_ns(tables.frames) == [5 * STEP_NS]
    assert (values.away_from_crossings(tables.frames)["stamp_ns"] // STEP_NS).to_list() == [0, 1, 9]
    assert values.boundaries(tables).height == 2 * 3
    assert values.covered(lanes(["measured"] * 4, [0.0] * 4, [None] * 4)) == Value(100.0)


def test_only_measured_boundaries_have_errors_and_the_others_cost_coverage():
    tables = lanes(["measured", "held", "lost", "measured"], [0.1, 5.0, 5.0, -0.5], [0] * 4)
    assert values.covered(tables).number == 75.0
    for place in ("at_car_m", "ahead_m"):
        assert values.gross(tables, place) == Value(pytest.approx(100 / 6), 0.75)
    assert values.offset_error(tables, 1.0) == Value(pytest.approx(50), 0.75)


@pytest.mark.parametrize(
    ("status", "right_from", "share"),
    [("measured", 5, 100), ("measured", 8, 100), ("measured", 9, 0), ("held", 5, 0)],
)
def test_a_lane_is_handed_over_in_time(status, right_from, share):
    errors_m = [0.0] * 5 + [3.5] * (right_from - 5) + [0.0] * (12 - right_from)
    tables = lanes([status] * 12, errors_m, [0] * 5 + [1] * 7)
    assert values.handed(tables) == Value(share, None, f"{share // 100} of 1 crossings")


def test_lanes_of_wrong_width_or_beside_the_car_are_implausible():
    tables = lanes(["measured"] * 4 + ["lost"], [0.0, -1.6, 4.0, -3.0, -3.0], [0] * 5)
    assert values.implausible(tables) == Value(75.0, 0.8)


def test_an_absent_boundary_needs_a_reason_of_the_lane_stage():
    codes = [["lanes.boundary_lost"], [], ["stereo.no_right_image"], []]
    tables = lanes(["lost", "held", None, "measured"], [0.0] * 4, [0] * 4, reason_codes=codes)
    assert values.silent(tables) == Value(50.0, None, "2 absent")


def test_steps_without_scale_reduce_the_coverage():
    tables = frames(step_m=[None, 1.1, None, 0.9], true_step_m=[None, 1.0, 1.0, 1.0])
    assert values.step_error(tables) == Value(pytest.approx(10.0), pytest.approx(2 / 3))
    assert values.length_error(tables).number == pytest.approx(0.0, abs=1e-9)
    assert values.with_scale(tables).number == pytest.approx(200 / 3)


@pytest.mark.parametrize(("auto", "met"), [(0.022, True), (0.023, False)])
def test_the_chosen_model_is_compared_with_the_better_one(auto, met):
    found = values.by_model(*(frames(error=[error, -error]) for error in (0.1, 0.02, auto)), column="error")
    assert found == Measured(f"10.00 / 2.00 / {100 * auto:.2f} cm", "100.0 %", met)


def test_the_chosen_features_are_compared_with_the_others():
    """They are lost in frames 0 and 2; the others track frames 0 and 1, and are off by 20 % in frame 2."""
    truth = {"frame": [0, 1, 2], "seed": [7] * 3, "true_step_m": [1.0] * 3}
    chosen = frames(**truth, step_m=[None, 1.12, None], odometry_status=["lost", "tracked", "lost"])
    steps_m = {"step_m": [0.9, 1.0, 1.2], "step_error_m": [0.09, 0.0, 0.2]}
    others = frames(**truth, **steps_m, odometry_status=["tracked"] * 3)
    found = values.lost_where_others_track(others, chosen)
    assert found == Value(1, None, "of 2; lost: 66.7 %, 0.0 %")
    assert values.as_exact(others, chosen) == Measured("10.00 / 12.00 %", "33.3 %", False)
    assert values.as_exact(chosen, others) == Measured("12.00 / 10.00 %", "100.0 %", True)


def test_the_obstacle_has_the_place_and_the_distance_of_the_public_solutions():
    found = {"label": ["car", "template"], "x_min_px": [0.0, 545.0], "y_min_px": [0.0, 480.0]}
    tables = objects(found | {"distance_m": [1.0, values.COURSE_DISTANCE_M - 0.002]})
    assert values.obstacle_place_off(tables) == Value(2.0)
    assert values.obstacle_off(tables) == Value(pytest.approx(2.0), None, "at (545, 480), 28.9246 m")


def test_only_the_last_frames_boundary_is_compared_with_its_line():
    tables = frames(lane_left_offset_m=[9.0, 1.75], lane_left_raw_offset_m=[1.0, 1.85])
    assert values.off_own_line(tables) == Value(pytest.approx(10.0))


def standing(odom_x_m, steps_m, true_steps_m):
    n = len(steps_m)
    zero = {f"odom_{axis}_m": [0.0] * n for axis in "yz"}
    columns = {"stamp_ns": [k * STEP_NS for k in range(n)], "step_m": steps_m, "true_step_m": true_steps_m}
    return frames(**columns, odom_x_m=odom_x_m, **zero)


def test_the_drift_is_that_of_one_stand_and_not_of_the_way_between_two():
    tables = standing([0.0, 1.0, 1.0, 1.02, 2.0, None, 2.5], [1.0] * 7, [None, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    assert values.standing_drift(tables) == Value(pytest.approx(2.0), 0.75, "4 standing frames")
    assert values.standing_drift(standing([0.0], [1.0], [1.0])) == Value(None, None, "0 standing frames")


def test_steps_need_a_possible_acceleration_also_over_a_gap():
    """12 m/s² at 10 Hz are 0.12 m more a step, and 0.24 m after one missing step."""
    steps_m = [None, 1.0, 1.11, 1.24, None, 1.47, None, 1.72]
    found = values.impossible_steps(standing([0.0] * 8, steps_m, [1.0] * 8))
    assert found == Value(2.0, 5 / 8, "of 5")


def test_errors_beyond_three_deviations_have_the_median_deviation_beside_them():
    table = {"kept": [True] * 3 + [False], "distance_m": [9.0, 8.0, None, 1.0], "distance_std_m": [0.1, 0.5, None, 0.1]}
    found = values.beyond(objects(table | {"true_distance_m": [9.4, 9.0, 9.0, 9.0]}), "distance")
    assert found == Value(50.0, pytest.approx(2 / 3), "2 values, median deviation 0.3 m")
    sides = {f"lane_{side}{name}_offset{std}_m": [value] for side in values.SIDES
             for name, std, value in (("", "", 1.0), ("_true", "", 1.1), ("", "_std", 0.05))}  # fmt: skip
    assert values.beyond(frames(**sides), "lane offset").number == 0.0


def test_precision_and_recall_use_sums_over_frames():
    tables = frames(filter_tp=[8, 1], filter_fp=[1, 0], filter_fn=[0, 1])
    assert values.precision(tables) == values.recall(tables) == Value(0.9, 1.0)


def test_impact_errors_count_frames_with_an_estimate():
    true_s = [1.0, 1.0, 2.0, 9.0]
    tables = frames(frame=[0, 1, 2, 3], time_to_impact_s=[1.1, None, 2.6, 9.0], true_time_to_impact_s=true_s)
    assert values.impact_known(tables).number == pytest.approx(200 / 3)
    assert values.impact_known(tables, first=2).number == 100.0
    assert values.impact_error(tables) == Value(pytest.approx(0.35), pytest.approx(2 / 3))


def test_an_alarm_without_a_true_impact_is_false():
    tables = frames(time_to_impact_s=[1.0, 1.0, 1.0, None, 1.6], true_time_to_impact_s=[None, 1.9, 2.1, None, 9.0])
    assert values.false_alarms(tables) == Value(2.0, None, "of 4")


def test_rows_of_one_object_are_not_independent():
    """Two cars, one always wrong: by rows the interval is narrow, by cars it is wide."""
    wrong = pl.Series(np.repeat([True, False], 40))
    assert values.share_by_object(wrong, pl.Series(np.repeat([0, 1], 40))) == (0.5, 0.0, 1.0, 2)
    share, low, high, count = values.share_by_object(wrong, pl.Series(range(80)))
    assert (share, count) == (0.5, 80)
    assert (low, high) == pytest.approx((0.39, 0.61), abs=0.015)  # binomial: 0.5 +- 1.96 sqrt(0.25 / 80)


def test_equal_track_numbers_of_two_replays_are_two_objects():
    table = {"kept": [True, True, False], "track_id": ["1", "1", "1"], "distance_m": [9.0, None, 9.0]}
    tables = objects(*[table | {"true_distance_m": [9.0, 19.0, 9.0]}] * 2)
    assert values.off_by_a_metre(tables, 0, 20) == Value(0.0, 0.5, "0.0 to 0.0, 2 objects")


def test_the_visible_share_is_that_of_the_areas_of_equal_objects():
    seen = {"frame": [0, 0, 1], "true_distance_m": [9.0, 20.0, None], "x_min_px": [0.0, 5.0, 0.0],
            "x_max_px": [4.0, 9.0, 9.0], "y_min_px": [0.0] * 3, "y_max_px": [5.0] * 3}  # fmt: skip
    whole = objects(seen | {"x_max_px": [8.0, 9.0, 9.0], "frame": [0, 3, 1]})
    assert values.with_visible_share(objects(seen), whole)["visible"].to_list() == [0.5]


def test_uncertainty_equals_that_of_the_report(tmp_path):
    path = write(tmp_path / "drive.metrics.parquet", [row(k, step_m=1.0 + k, true_step_m=1.0) for k in range(4)])
    pl.read_parquet(path).with_columns(step_std_m=pl.Series([1.0] * 4)).write_parquet(path)
    tables = Tables(None, None, (path,))
    assert values.deviations(tables, "step") == Measured("50.0 / 75.0 / 0.0 % (NEES 3.5)", "100.0 %", False)
    assert values.deviations(tables, "turn") == nothing("no truth")


def test_added_noise_equals_rendered_noise(tmp_path):
    options = drive("straight", scene="straight", width=160, height=120, seconds=0.2).options
    render_dump(tmp_path / "clean", replace(options, seed=3), force=False)
    noisy = replace(options, seed=3, tag_noise=0.05, depth_noise=0.02)
    render_dump(tmp_path / "rendered", noisy, force=False)
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
