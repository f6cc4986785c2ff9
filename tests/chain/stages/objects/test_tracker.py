"""Objects over time, with known motions, persistent ids, and templates moved by known pixels."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects import object_track, tracker
from roadperc_stream.chain.stages.objects.object_track import predict
from roadperc_stream.chain.stages.objects.tracker import ObjectsState, step
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.model import Absent, Box, Reason
from tests.analytic import STEP_NS, box
from tests.chain.stages.objects.frames import CAMERA, CFG, FAR_M, LIMIT_M, Follower, depth_of, moved, tags_of, texture
from tests.scenes import scene_of

CAR = box("Car", 100, 80, 140, 110)


def shifted(detection, right, down=0):
    b = detection.box_px
    return box(detection.label, b.x_min + right, b.y_min + down, b.x_max + right, b.y_max + down)


def drive(speed_mps, *, frames=20, steps_ns=(STEP_NS,), noise_m=0.0, start_m=20.0):
    """A car whose distance shrinks at a constant speed; its last object and true distance."""
    follower, rng, distance = Follower(), np.random.default_rng(0), start_m
    for k in range(frames):
        dt_ns = steps_ns[k % len(steps_ns)]
        distance -= speed_mps * dt_ns / 1e9
        follower.frame(CAR, depth_m=distance + rng.normal(0, noise_m), dt_ns=dt_ns)
    return follower.only, distance


@pytest.mark.parametrize(
    ("noise_m", "steps_ns"),
    [(0.0, (STEP_NS,)), (0.02, (STEP_NS,)), (0.0, (20_000_000, 110_000_000, 50_000_000))],
    ids=["exact", "noise", "irregular stamps"],
)
def test_approaching_at_5_metres_per_second(noise_m, steps_ns):
    item, distance = drive(5.0, noise_m=noise_m, steps_ns=steps_ns)
    assert item.closing_speed_mps == pytest.approx(5.0, abs=0.3)
    assert item.time_to_impact_s == pytest.approx(distance / 5.0, rel=0.05)
    assert (item.status, item.track_id) == ("measured", "1")


@pytest.mark.parametrize("speed", [-5.0, 0.0, 0.3])
def test_an_object_that_does_not_certainly_come_nearer_has_no_time_to_impact(speed):
    item, _ = drive(speed)
    assert item.closing_speed_mps == pytest.approx(speed, abs=0.3)
    assert (item.time_to_impact_s, item.time_to_impact_std_s) == (None, None)


def test_standard_deviations_agree_with_the_errors_of_many_logs():
    """With the assumed noise, errors agree with their standard deviations, which also allow for changes of speed."""
    errors, impacts = [], []
    for seed in range(40):
        follower, rng, distance = Follower(), np.random.default_rng(seed), 40.0
        for _ in range(30):
            distance -= 8.0 * STEP_NS / 1e9
            follower.frame(CAR, depth_m=distance + rng.normal(0, CFG.min_distance_std_m))
        item = follower.only
        errors.append((item.closing_speed_mps - 8.0) / item.closing_speed_std_mps)
        impacts.append((item.time_to_impact_s - distance / 8.0) / item.time_to_impact_std_s)
    assert 0.3 < np.std(errors) < 1.1
    assert 0.3 < np.std(impacts) < 1.1


@pytest.mark.parametrize(
    ("corners", "expected"),
    [
        ((10.0, 20.0, 30.0, 40.0), (10.0, 20.0, 30.0, 40.0)),
        ((-5.0, -6.0, 400.0, 300.0), (0.0, 0.0, 320.0, 240.0)),
        ((330.0, 250.0, 340.0, 260.0), (320.0, 240.0, 320.0, 240.0)),
        ((-9.0, -8.0, -2.0, -1.0), (0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_boxes_are_clipped_to_the_image(corners, expected):
    assert astuple(tracker._within(CAMERA, Box(*corners))) == expected


@pytest.mark.parametrize(("frames", "depth_m"), [(1, 20.0), (5, None)], ids=["one distance", "no depth"])
def test_without_two_distances_an_object_has_an_id_but_no_motion(frames, depth_m):
    follower = Follower()
    for _ in range(frames):
        follower.frame(CAR, depth_m=depth_m)
    item = follower.only
    assert (item.track_id, item.distance_m, item.closing_speed_mps, item.time_to_impact_s) == ("1", depth_m, None, None)


def test_a_jump_to_something_in_front_is_rejected():
    follower = Follower()
    for k in range(20):
        follower.frame(CAR, depth_m=20.0 - 0.25 * k)
    for _ in range(3):
        follower.frame(CAR, depth_m=6.0)
        assert follower.only.distance_m == 6.0
        assert follower.only.closing_speed_mps == pytest.approx(5.0, abs=0.3)
        assert follower.only.time_to_impact_s is None, "6 m and 15 m would be two different times"
    follower.frame(CAR, depth_m=20.0 - 0.25 * 23)
    assert follower.only.closing_speed_mps == pytest.approx(5.0, abs=0.3)
    assert follower.only.time_to_impact_s == pytest.approx((20.0 - 0.25 * 23) / 5.0, rel=0.1)
    assert follower.only.track_id == "1"


@pytest.mark.parametrize(("restart_s", "frames"), [(0.05, 1), (0.2, 4), (0.4, 8)])
def test_a_jump_is_accepted_after_restart_s(restart_s, frames):
    """``frames`` of 50 ms pass after the jump before the filtered distance jumps too."""
    follower = Follower(CFG.model_copy(update={"restart_s": restart_s}))
    for _ in range(20):
        follower.frame(CAR, depth_m=20.0)
    accepted = []
    for _ in range(frames + 2):
        follower.frame(CAR, depth_m=10.0)
        accepted.append(follower.state.tracks[0].distance_m.value == pytest.approx(10.0, abs=0.1))
    assert accepted == [False] * frames + [True] * 2


def test_a_distance_that_other_distances_contradict_is_not_expected_for_long():
    """Else a nearer object in the same box would have no distance."""
    follower = Follower()
    for _ in range(20):
        follower.frame(CAR, depth_m=20.0)
    expected = []
    for _ in range(6):
        (track,) = follower.state.tracks
        later = predict(CFG, track, track.stamp_ns + STEP_NS)
        expected.append(object_track.expected(CFG, later).distance_m)
        follower.frame(CAR, depth_m=8.0)
    assert expected[:4] == [pytest.approx(20.0, abs=0.1)] * 4
    assert expected[4] is None, "the distances have been wrong for longer than restart_s"
    assert expected[5] == pytest.approx(8.0, abs=0.1), "the track restarted"


def test_the_closing_speed_by_stereo_covers_an_error_that_all_distances_share():
    """1 / distance is wrong by 0.006 / m, twice its deviation: the error of the distance shrinks on the way."""
    follower, sigmas = Follower(), []
    for true_m in np.arange(30.0, 12.0, -0.5):
        follower.frame(CAR, depth_m=float(1.0 / (1.0 / true_m + 0.006)), inverse_std=0.003)
        item = follower.only
        if item.closing_speed_mps is not None:
            sigmas.append((item.closing_speed_mps - 0.5 / (STEP_NS / 1e9)) / item.closing_speed_std_mps)
    assert len(sigmas) > 10
    assert np.abs(sigmas).max() < 3.0


@pytest.mark.parametrize(("gate", "accepted"), [(CFG.gate, False), (1e4, True)])
def test_a_jump_beyond_the_gate_is_rejected(gate, accepted):
    """The jump is 14 standard deviations of measurement and prediction."""
    follower = Follower(CFG.model_copy(update={"gate": gate}))
    for _ in range(20):
        follower.frame(CAR, depth_m=20.0)
    before = follower.state.tracks[0].distance_m
    follower.frame(CAR, depth_m=18.0)
    after = follower.state.tracks[0].distance_m
    predicted = before.predict(CFG.process_noise, STEP_NS / 1e9)
    expected = predicted.update(18.0, CFG.min_distance_std_m) if accepted else predicted
    assert CFG.gate < predicted.surprise(18.0, CFG.min_distance_std_m) < 1e4
    assert astuple(after) == pytest.approx(astuple(expected))
    assert (follower.state.tracks[0].rival_m is None) == accepted


@pytest.mark.parametrize(("min_overlap", "name"), [(0.33, "1"), (0.34, "2")])
def test_a_box_that_overlaps_less_is_a_new_object(min_overlap, name):
    """Moved by half its width, a box has an overlap of a third."""
    follower = Follower(CFG.model_copy(update={"min_overlap": min_overlap}))
    follower.frame(CAR)
    assert follower.frame(shifted(CAR, 20))[0].track_id == name


def test_alternating_distances_do_not_restart_the_track():
    """Two cars alternate in one box: the track of the first one continues."""
    follower = Follower()
    for _ in range(10):
        follower.frame(CAR, depth_m=20.0)
    for k in range(30):
        follower.frame(CAR, depth_m=12.0 if k % 2 else 20.0)
        assert follower.only.closing_speed_mps == pytest.approx(0.0, abs=0.1)


def test_crossing_boxes_keep_their_ids():
    """One drives to the right in front, the other to the left behind it; in the middle the boxes coincide."""
    follower, names = Follower(), []
    for k in range(41):
        near, far = box("Car", 60 + 4 * k, 80, 100 + 4 * k, 110), box("Car", 220 - 4 * k, 80, 260 - 4 * k, 110)
        tags, depth = tags_of(near, far), depth_of((far, 30.0), (near, 12.0))
        order = (near, far) if k % 2 else (far, near)
        found = {item.detection: item.track_id for item in follower.frame(*order, depth_m=depth, tags=tags)}
        if near != far:
            names.append((found[near], found[far]))
    assert set(names) == {names[0]}
    assert set(names[0]) == {"1", "2"}


@pytest.mark.parametrize(
    ("labels", "names"),
    [(("Car", "Pedestrian", "Car", "Van"), ["1", "2", "1", "1"]), (("Unicorn", "Dragon", "Unicorn"), ["1", "2", "1"])],
    ids=["kinds", "labels no table knows"],
)
def test_only_labels_of_one_kind_share_an_id(labels, names):
    follower = Follower()
    assert [follower.frame(replace(CAR, label=label))[0].track_id for label in labels] == names


def test_dropped_detections_stay_as_they_are_and_are_not_tracked():
    follower, stray = Follower(), box("Car", 10, 10, 40, 40)
    for _ in range(4):
        kept, dropped = follower.frame(CAR, stray, depth_m=20.0, tags=tags_of(CAR))
    assert (kept.track_id, kept.kept) == ("1", True)
    assert (dropped.track_id, dropped.kept, dropped.closing_speed_mps) == ("", False, None)
    assert len(follower.state.tracks) == 1


@pytest.mark.parametrize(("missing", "name"), [(9, "1"), (10, "2")])
def test_the_id_of_an_unseen_object_is_kept_for_half_a_second(missing, name):
    follower = Follower()
    follower.frame(CAR)
    for _ in range(missing):
        assert follower.frame() == ()
    assert follower.frame(CAR)[0].track_id == name


def seen_for(frames, follower, image, *, right=0, down=0, depth_m=None, car=CAR):
    """Run ``frames`` frames in which the car is detected and moves by whole pixels; returns ``frames``."""
    for k in range(frames):
        follower.frame(shifted(car, right * k, down * k), grey=moved(image, right * k, down * k), depth_m=depth_m)
    return frames


@pytest.mark.parametrize(("right", "down"), [(0, 0), (3, -1), (-5, 2)])
def test_a_missed_detection_is_tracked_by_its_template(right, down):
    follower, image = Follower(), texture()
    first = seen_for(4, follower, image, right=right, down=down, depth_m=15.0)
    for k in range(first, first + 10):
        follower.frame(grey=moved(image, right * k, down * k), depth_m=15.0)
        item = follower.only
        assert (item.status, item.track_id, item.kept) == ("tracked", "1", True)
        assert item.detection.score == CAR.score
        assert item.distance_m == 15.0
        expected = astuple(shifted(CAR, right * k, down * k).box_px)
        np.testing.assert_allclose(astuple(item.detection.box_px), expected, atol=1)
    assert follower.frame(grey=moved(image, right * (first + 10), down * (first + 10)), depth_m=15.0) == ()
    assert follower.state.tracks == ()


def test_a_large_object_is_found_by_a_template_of_its_middle():
    follower, image, large = Follower(), texture(), box("Car", 40, 20, 240, 200)
    first = seen_for(4, follower, image, right=2, car=large)
    assert follower.state.tracks[0].template.grey.shape == (96, 96)
    follower.frame(grey=moved(image, 2 * first, 0))
    np.testing.assert_allclose(astuple(follower.only.detection.box_px), (48, 20, 248, 200), atol=1)


def test_an_object_cut_by_the_images_border_keeps_its_speed_while_its_template_is_found():
    """Another point of it is the nearest one in each frame, so its distance stays although it passes at 5 m/s."""
    follower, car = Follower(CFG.model_copy(update={"template_min_score": 0.5})), box("Car", 8, 90, 68, 150)
    image = texture(1, (60, 80)).repeat(4, axis=0).repeat(4, axis=1)
    for k in range(9):
        follower.frame(shifted(car, -k), grey=moved(image, -k, 0), depth_m=10.0 - 0.25 * k)
    for _ in range(4):
        follower.frame(grey=moved(image, -8, 0), depth_m=8.0)
        assert follower.only.status == "tracked"
        assert follower.only.detection.box_px.x_min < 1
        assert follower.only.closing_speed_mps == pytest.approx(5.0, abs=0.5)


def test_an_object_that_grows_is_found_at_its_size():
    """From 20 m to 16 m everything is a quarter larger."""
    scene = texture(1, (60, 80)).repeat(4, axis=0).repeat(4, axis=1)
    follower = Follower(CFG.model_copy(update={"template_min_score": 0.6}))
    for k in range(17):
        distance = 20.0 - 0.25 * k
        scale = 20.0 / distance
        rows, columns = (np.rint((np.arange(n) - n / 2) / scale + n / 2).astype(int) for n in CAMERA.size)
        grey = np.ascontiguousarray(scene[np.ix_(rows, columns)])
        half = 20 * scale
        car = box("Car", 160 - half, 120 - half, 160 + half, 120 + half)
        if k < 10:
            follower.frame(car, grey=grey, depth_m=distance)
        else:
            follower.frame(grey=grey, depth_m=distance)
            assert follower.only.status == "tracked"
            np.testing.assert_allclose(astuple(follower.only.detection.box_px), astuple(car.box_px), atol=1.5)
            assert follower.only.closing_speed_mps == pytest.approx(5.0, abs=0.3)


def test_a_stray_detection_is_not_tracked_by_default():
    image = texture()
    for after_s, expected in ((0.1, 0), (0.0, 1)):
        follower = Follower(CFG.model_copy(update={"carry_after_s": after_s}))
        follower.frame(CAR, grey=image)
        assert len(follower.frame(grey=image)) == expected


def test_an_object_that_disappears_keeps_its_id():
    follower = Follower()
    seen_for(4, follower, texture())
    for grey in (texture(7), None, np.full(CAMERA.size, 90, np.uint8)):
        assert follower.frame(grey=grey) == ()
    (item,) = follower.frame(grey=texture())
    assert (item.track_id, item.status) == ("1", "tracked")


def test_a_match_the_tags_contradict_is_rejected():
    follower, image = Follower(), texture()
    for _ in range(4):
        follower.frame(CAR, grey=image, tags=tags_of(CAR))
    assert follower.frame(grey=image, tags=tags_of()) == ()
    assert len(follower.frame(grey=image, tags=tags_of(CAR))) == 1


def test_a_match_on_a_detected_object_is_dropped():
    """Two ids on one car, one from a box on half of it: only the detected object is reported."""
    follower, image, half = Follower(), texture(), box("Car", 100, 80, 120, 110)
    for _ in range(4):
        follower.frame(CAR, half, grey=image, depth_m=20.0)
    assert [item.status for item in follower.frame(CAR, grey=image, depth_m=20.0)] == ["measured"]


def test_objects_tracked_by_template_come_last_whatever_their_age():
    follower, image, late = Follower(), texture(), box("Car", 200, 80, 240, 110)
    for _ in range(4):
        follower.frame(CAR, late, grey=image)
    later, coasted = follower.frame(late, grey=image)
    assert [(later.status, later.detection), (coasted.status, coasted.track_id)] == [
        ("measured", late),
        ("tracked", "1"),
    ]


def test_a_missing_message_is_bridged_else_it_is_a_reason():
    follower, image = Follower(), texture()
    seen_for(4, follower, image)
    absent = Absent(Reason("objects", "no_detections"))
    state, coasted = step(CFG, follower.state, scene_of(CAMERA, grey=image, stamp_ns=follower.stamp_ns + STEP_NS))
    assert [item.status for item in coasted.objects] == ["tracked"]
    assert step(CFG, state, scene_of(CAMERA, stamp_ns=follower.stamp_ns + 2 * STEP_NS))[1] == absent
    assert step(CFG, ObjectsState(), scene_of(CAMERA, grey=image, stamp_ns=STEP_NS))[1] == absent


def test_the_number_of_tracks_is_bounded(monkeypatch):
    monkeypatch.setattr(tracker, "MOST_TRACKS", 5)
    follower = Follower(ObjectsConfig(hold_s=1e4))
    for k in range(30):
        follower.frame(box("Car", 10 * k, 10, 10 * k + 8, 20))
    assert [track.number for track in follower.state.tracks] == [26, 27, 28, 29, 30]


def test_an_object_that_partly_lies_beyond_the_depths_range_is_tracked():
    """Its distance has no standard deviation."""
    follower, depth = Follower(), np.full(CAMERA.size, LIMIT_M, np.float32)
    depth[80:82, 100:130] = FAR_M
    for _ in range(3):
        follower.frame(box("Car", 100, 80, 140, 105), depth_m=depth)
    assert follower.only.distance_m == FAR_M
    assert follower.only.distance_std_m is None
    assert follower.state.tracks[0].distance_m is not None
