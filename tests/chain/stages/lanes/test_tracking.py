"""The boundary's Kalman filter, and the majority of the classes beside it."""

import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from roadperc_stream.chain.stages.lanes import tracking
from roadperc_stream.chain.stages.lanes.curves import Curve, lateral
from roadperc_stream.chain.stages.lanes.tracking import ClassHistory, LanesState
from roadperc_stream.config import LanesConfig
from roadperc_stream.model import Odometry
from tests.analytic import ROAD, STEP_NS, VEHICLE, Road
from tests.chain.stages.lanes.test_ego_lane import look

CFG = LanesConfig()
R = np.diag([0.03, 0.005, 0.001]) ** 2


def seen(*state, drawn=(0.0, 0.0, 0.0)):
    """A measured boundary."""
    return Curve(np.array(state), R, 20.0, np.array(drawn))


def test_a_new_track_equals_its_measurement_with_unknown_rate():
    track = tracking.start(seen(1.7, 0.01, 0.002), 7)
    np.testing.assert_array_equal(track.state, [1.7, 0.01, 0.002])
    np.testing.assert_array_equal(track.state_covariance, R)
    np.testing.assert_array_equal(track.covariance[1], [0.0, 1.0, 0.0, 0.0, 0.0])


def test_jitter_shrinks_and_a_drift_is_tracked_without_lag():
    rng = np.random.default_rng(0)
    true = 1.7 + 0.01 * np.arange(200)
    measured = true + rng.normal(0, 0.03, 200)
    track, offsets = tracking.start(seen(measured[0], 0.0, 0.0), 0), []
    for k, offset_m in enumerate(measured):
        track = tracking.predict(CFG, track, k * STEP_NS, None)
        track = tracking.update(CFG, track, seen(offset_m, 0.0, 0.0))
        offsets.append(track.state[0])
    jitter = np.std(np.diff(offsets[20:], 2)) / np.std(np.diff(measured[20:], 2))
    assert jitter < 1 / 3
    assert abs(np.mean(offsets[50:] - true[50:])) < 0.005


def moved(dx, dy=0.0, turn=0.0, y_std_m=0.005, yaw_std=0.0015):
    """Odometry of one step, with standard deviations of y and yaw."""
    covariance = np.diag([9.0, y_std_m, 9.0, 9.0, 9.0, yaw_std]) ** 2
    return Odometry("tracked", np.eye(4), last_T_this(dx, dy, turn), covariance=tuple(covariance.ravel()))


def last_T_this(dx, dy, turn):
    T = np.eye(4)
    T[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    T[:2, 3] = dx, dy
    return T


def test_a_step_ahead_in_a_bend_moves_the_boundary_against_the_car():
    """After 2 m straight ahead, heading and curvature of a boundary change its offset and heading."""
    track = tracking.start(seen(1.7, 0.02, 0.01), 0)
    after = tracking.predict(CFG, track, STEP_NS, moved(2.0))
    np.testing.assert_allclose(after.state, [1.7 + 0.04 + 0.02, 0.04, 0.01], atol=1e-12)


def test_a_step_aside_and_a_turn_are_subtracted():
    track = tracking.start(seen(1.7, 0.0, 0.0), 0)
    after = tracking.predict(CFG, track, STEP_NS, moved(0.5, 0.1, 0.03))
    # The turned y axis meets the boundary at a slant.
    np.testing.assert_allclose(after.state, [1.6 / np.cos(0.03), -np.tan(0.03), 0.0], rtol=1e-9, atol=1e-12)
    assert after.mean[1] == pytest.approx((1.6 / np.cos(0.03) - 1.7) / 0.05)


def test_a_line_beside_a_turning_car_stays_in_place():
    """In a lane change, second-order errors of the steps would add up."""
    exact = {"y_std_m": 0.0, "yaw_std": 0.0}
    track = exactly_known((1.7, 0.0, 0.0))
    for k in range(1, 11):
        track = tracking.predict(CFG, track, k * STEP_NS, moved(0.5, 0.0, 0.02, **exact))
    headings = 0.02 * np.arange(10)
    across_m = 1.7 - 0.5 * np.sin(headings).sum()
    np.testing.assert_allclose(track.state, [across_m / np.cos(0.2), -np.tan(0.2), 0.0], rtol=1e-6, atol=1e-12)


def exactly_known(state, rate=0.0):
    """A track without uncertainty, so that a prediction's covariance is that of the motion."""
    offset, heading, curvature = state
    return tracking.BoundaryTrack(np.array([offset, rate, heading, curvature, 0.0]), np.zeros((5, 5)), 0, 0)


def test_without_odometry_the_rate_is_a_random_walk():
    """With q = 2 m/s and t = 0.5 s, offset and rate have the covariance q^2 (t^3 / 3, t^2 / 2; t^2 / 2, t)."""
    cfg = CFG.model_copy(update={"process_noise": 2.0})
    predicted = tracking.predict(cfg, exactly_known((1.7, 0.01, 0.002), rate=-0.4), 10 * STEP_NS, None)
    np.testing.assert_allclose(predicted.mean, [1.5, -0.4, 0.01, 0.002, 0.0])
    covariance = predicted.covariance
    np.testing.assert_allclose(covariance[:2, :2], [[4 * 0.125 / 3, 0.5], [0.5, 2.0]])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)[2:4] / 0.5), [0.02, 0.003])
    np.testing.assert_array_equal(covariance[2:, :2], 0.0)


@pytest.mark.parametrize("with_odometry", [False, True])
def test_the_prediction_does_not_depend_on_the_number_of_steps(with_odometry):
    def step(metres):
        return moved(metres, y_std_m=0.0, yaw_std=0.0) if with_odometry else None

    start = exactly_known((1.7, 0.0, 0.01), rate=0.3)
    once, often = tracking.predict(CFG, start, 10 * STEP_NS, step(5.0)), start
    for k in range(1, 11):
        often = tracking.predict(CFG, often, k * STEP_NS, step(0.5))
    np.testing.assert_allclose(often.state, once.state)
    np.testing.assert_allclose(often.state_covariance, once.state_covariance, atol=1e-15)
    if not with_odometry:
        np.testing.assert_allclose(often.mean, once.mean)
        np.testing.assert_allclose(often.covariance, once.covariance, atol=1e-15)


@pytest.mark.parametrize("dx", [4.0, -4.0])
def test_with_odometry_noise_comes_from_the_step_and_the_road(dx):
    """Per root metre: curvature 0.0008 / m, heading 0.0008, offset 0.002 m; plus y and yaw of the step."""
    covariance = tracking.predict(CFG, exactly_known((1.7, 0.0, 0.0)), STEP_NS, moved(dx, y_std_m=0.02)).covariance
    of_road = 0.0008**2 * np.array([4.0**5 / 20, 4.0**3 / 3, 4.0])
    of_road += [0.0008**2 * 4.0**3 / 3 + 0.002**2 * 4.0, 0.0008**2 * 4.0, 0.0]
    np.testing.assert_allclose(np.diag(covariance)[[0, 2, 3]], of_road + np.array([0.02**2, 0.0015**2, 0.0]))
    np.testing.assert_allclose(covariance[2, 3], 0.0008**2 * dx * 4.0 / 2)


def test_with_odometry_uncertainty_is_propagated_along_the_road():
    """After 2 m, heading errors change the offset; curvature errors change offset and heading."""
    known = exactly_known((1.7, 0.0, 0.0))
    for column, seen in ((2, [0.02, 0.01, 0.0]), (3, [0.02, 0.02, 0.01])):
        uncertain = np.zeros((5, 5))
        uncertain[column, column] = 0.01**2
        track = tracking.BoundaryTrack(known.mean, uncertain, 0, 0)
        added = (
            tracking.predict(CFG, track, STEP_NS, moved(2.0)).state_covariance
            - tracking.predict(CFG, known, STEP_NS, moved(2.0)).state_covariance
        )
        np.testing.assert_allclose(added, np.outer(seen, seen), atol=1e-12)


def test_an_update_weighs_prediction_and_measurement_by_variance():
    """Two equally good offsets give their mean with half the variance; the unmeasured rate stays."""
    track = tracking.start(seen(1.7, 0.0, 0.0), 0)
    after = tracking.update(CFG, track, seen(1.74, 0.002, 0.0))
    np.testing.assert_allclose(after.state, [1.72, 0.001, 0.0], atol=1e-12)
    np.testing.assert_allclose(after.state_covariance, R / 2, atol=1e-15)
    assert after.covariance[1, 1] == 1.0


def test_a_bend_ahead_makes_the_reported_deviation_larger():
    """A straight boundary, drawn aside by a bend ahead in all later measurements: it stays, its deviation grows."""
    drawn = np.array([400.0, -110.0, 17.0])
    track = tracking.start(seen(1.7, 0.0, 0.0, drawn=drawn), 0)
    for _ in range(20):
        track = tracking.update(CFG, track, seen(1.7, 0.0, 0.0, drawn=drawn))
    np.testing.assert_array_equal(track.reported_covariance[:2, :2], track.state_covariance[:2, :2])
    for number in range(1, 6):
        track = tracking.predict(CFG, track, number * STEP_NS, moved(1.0))
        track = tracking.update(CFG, track, seen(1.7 + 0.06, -0.0165, 0.0025, drawn=drawn))
    assert track.state[0] == pytest.approx(1.7, abs=0.02)
    without_bend = replace(track, mean=np.append(track.mean[:4], 0.0))
    assert (np.diag(track.reported_covariance) > 1.1 * np.diag(without_bend.reported_covariance)).all()


def test_a_boundary_is_known_ahead_where_its_curvature_changes():
    """The car drives straight ahead beside y = 1.7 + c x^3 / 6, which is measured 4 to 40 m ahead by a parabola."""
    slope_per_m2 = 5e-5
    ahead_m = np.linspace(4.0, 40.0, 100)
    drawn = np.polyfit(ahead_m, ahead_m**3 / 6, 2)[::-1] * (1.0, 1.0, 2.0)
    for driven_m in range(40):
        truth = np.array([1.7, 0.0, 0.0]) + slope_per_m2 * np.array([driven_m**3 / 6, driven_m**2 / 2, driven_m])
        curve = seen(*(truth + slope_per_m2 * drawn), drawn=drawn)
        if driven_m == 0:
            track = tracking.start(curve, 0)
            continue
        track = tracking.predict(CFG, track, driven_m * STEP_NS, moved(1.0))
        track = tracking.update(CFG, track, curve)
    for x_m in (10.0, 15.0):
        true_m = lateral(truth, x_m) + slope_per_m2 * x_m**3 / 6
        assert lateral(track.reported_state, x_m) == pytest.approx(true_m, abs=0.01)
    true_m = lateral(truth, 30.0) + slope_per_m2 * 30.0**3 / 6
    assert tracking.lateral_at(track, np.array([30.0]))[0] == pytest.approx(true_m, abs=0.05)
    straight = replace(track, mean=np.append(track.mean[:4], 0.0))
    across = np.array([1.0, x_m, x_m**2 / 2])
    assert across @ straight.reported_covariance @ across == pytest.approx(tracking.std_at(straight, x_m) ** 2)


@pytest.mark.parametrize(("sigmas", "taken"), [(0.99, True), (1.01, False)])
def test_the_gate_is_a_squared_distance_in_standard_deviations(sigmas, taken):
    track = tracking.start(seen(1.7, 0.0, 0.0), 0)
    aside = seen(1.7 + sigmas * np.sqrt(CFG.gate * 2 * R[0, 0]), 0.0, 0.0)
    assert (tracking.update(CFG, track, aside) is not None) == taken


def after(*names, step_ns=STEP_NS, cfg=CFG):
    """The majority after each observed class."""
    history, majorities = ClassHistory(), []
    for k, name in enumerate(names):
        history = history.add(cfg, k * step_ns, name)
        assert len(history.observations) <= 256
        majorities.append(history.majority)
    return majorities


def test_a_lasting_change_of_class_wins_after_half_the_window():
    for step_ns, frames in ((STEP_NS, 6), (STEP_NS // 2, 11)):
        majorities = after(*["road"] * 40, *["sidewalk"] * 20, step_ns=step_ns)
        assert majorities[40:].index("sidewalk") + 1 == frames


def test_the_majority_of_the_classes_in_the_window():
    """The latest of equally frequent classes wins; empty names are ignored; without a window only one frame counts."""
    assert after("road", "vehicle") == ["road", "vehicle"]
    assert after("vehicle", "road", "road", "vehicle")[-1] == "vehicle"
    assert after("road", *[""] * 12) == ["road"] * 11 + [""] * 2
    assert after("road", "road", "vehicle", cfg=CFG.model_copy(update={"hold_s": 0.0}))[-1] == "vehicle"
    assert set(after(*["road"] * 1000, step_ns=1000)) == {"road"}


def test_the_lanes_classes_do_not_flicker():
    """A vehicle beyond the left line in every third frame does not change the class; a lasting one does."""
    road = Road()
    tags = road.tags()
    covered, y = tags.copy(), road.ground()[1][..., 1]
    covered[(y > 2.0) & (y < 4) & (tags == ROAD)] = VEHICLE
    state, outside = LanesState(), []
    for k in range(24):
        state, lanes = look(road, covered if k % 3 == 2 or k >= 12 else tags, state, k)
        state = pickle.loads(pickle.dumps(state))
        outside.append(lanes.side("left").outside)
    assert set(outside[:12]) == {"road"}
    assert outside[-1] == "vehicle"
    assert sum(a != b for a, b in pairwise(outside)) == 1


def test_a_held_boundary_keeps_its_classes():
    road = Road()
    state, _ = look(road)
    blank = road.tags() * 0 + ROAD
    for k in range(1, 11):
        state, lanes = look(road, blank, state, k)
        assert (lanes.side("right").status, lanes.side("right").outside) == ("held", "sidewalk")
