"""Association of detections with objects, in any order of the detections."""

from collections import Counter
from dataclasses import replace
from time import process_time

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.chain.stages.objects import object_track
from roadperc_stream.chain.stages.objects.association import DISTANCE_PENALTY, overlap_similarities, similarities
from roadperc_stream.chain.stages.objects.place import Sighting
from roadperc_stream.geometry.assignment import largest_total
from roadperc_stream.model import Box, Object
from roadperc_stream.model.tag_tables import classes_of_label
from tests.analytic import box
from tests.chain.stages.objects.frames import CFG, Follower

corner = st.integers(0, 200)
side = st.integers(4, 60)
detections = st.builds(
    lambda label, x, y, w, h: box(label, x, y, x + w, y + h),
    st.sampled_from(["Car", "Pedestrian"]),
    corner,
    corner,
    side,
    side,
)
drives = st.lists(st.lists(detections, max_size=6), min_size=1, max_size=5)


def depth_image():
    rows, columns = np.indices((240, 320), np.float32)
    return 5 + rows / 10 + columns / 20


@settings(max_examples=60)
@given(drives, st.randoms(use_true_random=False))
def test_the_order_of_detections_affects_only_the_order_of_objects(frames, random):
    usual, shuffled, depth = Follower(), Follower(), depth_image()
    for frame in frames:
        other = random.sample(frame, len(frame))
        a, b = usual.frame(*frame, depth_m=depth), shuffled.frame(*other, depth_m=depth)
        assert Counter(a) == Counter(b)
        assert [item.detection for item in b] == other


@settings(max_examples=60)
@given(drives)
def test_track_ids_are_unique_and_never_reused(frames):
    follower, known = Follower(), set()
    for frame in frames:
        before = {str(track.number) for track in follower.state.tracks}
        names = [item.track_id for item in follower.frame(*frame)]
        assert len(set(names)) == len(names)
        assert not (set(names) - before) & known
        known |= set(names)


def item_at(distance_m, label="Car"):
    return Object(box(label, 0, 0, 10, 10), kept=True, distance_m=distance_m, distance_std_m=0.1)


def track_at(distance_m, number=1):
    return object_track.start(CFG, number, item_at(distance_m), Box(0, 0, 10, 10), 0)


def plain_similarity(cfg, track, item, box_px):
    """The similarity of one pair in Python floats, as a reference for ``overlap_similarities``."""
    kinds = [classes_of_label(thing.detection.label) or (thing.detection.label,) for thing in (track, item)]
    if kinds[0] != kinds[1]:
        return 0.0
    contradiction = 0.0
    if track.distance_m is not None and item.distance_m is not None:
        surprise = track.distance_m.surprise(item.distance_m, object_track.distance_std_m(cfg, item))
        contradiction = min(surprise / cfg.gate, 1.0)
    score = track.box_px.overlap(box_px) * (1.0 - DISTANCE_PENALTY * contradiction)
    return score if score >= cfg.min_overlap else 0.0


def test_similarities_of_all_pairs_equal_those_of_single_pairs():
    rng = np.random.default_rng(0)

    def items(count):
        corners = rng.uniform(0, 20, (count, 2)).tolist()
        labels = rng.choice(["Car", "van", "Car", "kite", "Kite"], count).tolist()
        made = [Object(box(a, x, y, x + 30, y + 20), kept=True) for a, (x, y) in zip(labels, corners, strict=True)]
        known = [replace(item, distance_m=d) for item, d in zip(made, rng.normal(20, 1, count).tolist(), strict=True)]
        surer = [replace(item, distance_std_m=abs(float(rng.normal()))) for item in known[::2]]
        return [*made[: count // 4], *known[count // 4 :], *surer]

    detected, before = items(200), items(170)
    tracks = [object_track.start(CFG, k, item, item.detection.box_px, 0) for k, item in enumerate(before)]
    tracks = [object_track.predict(CFG, track, 50_000_000) for track in tracks]
    boxes = [item.detection.box_px for item in detected]
    expected = [[plain_similarity(CFG, t, item, b) for item, b in zip(detected, boxes, strict=True)] for t in tracks]
    found = overlap_similarities(CFG, tracks, detected, boxes)
    np.testing.assert_array_equal(found, expected)
    assert 0.2 < np.mean(found > 0) < 0.8


def test_the_place_on_the_ground_comes_before_the_overlap():
    """A person who has left the box of the last frame, and another one who is in it, but 6 m farther away."""
    track = object_track.seen_at(track_at(20.0), Sighting((0.0, 0.0, 20.0), 0.2, 0.2))
    items, boxes = [item_at(20.0), item_at(26.0)], [Box(11, 0, 21, 10), Box(0, 0, 10, 10)]
    seen = [Sighting((0.4, 0.0, 20.0), 0.2, 0.2), Sighting((0.0, 0.0, 26.0), 0.2, 0.2), None]
    assert largest_total(similarities(CFG, [track], items, boxes, seen[:2])) == {0: 0}
    assert largest_total(similarities(CFG, [track], items[:1], boxes[:1], seen[2:])) == {}
    assert similarities(CFG, [track], items[1:], boxes[1:], seen[1:2]) > 0, "its distance may have jumped"


def test_boxes_that_overflow_have_no_similarity():
    wild = Box(-1.7e308, -1.7e308, 1.7e308, 1.7e308)
    scores = overlap_similarities(CFG, [track_at(None)], [item_at(None)] * 2, [wild, Box(0, 0, 1e-200, 1e-200)])
    assert scores.tolist() == [[0.0, 0.0]]
    assert similarities(CFG, [track_at(None)], [], [], []).shape == (1, 0)


def test_thousands_of_detections_are_associated_within_a_second():
    seen = Sighting((0.0, 0.0, 20.0), 0.1, 0.1)
    tracks = [object_track.seen_at(track_at(20.0, number), seen) for number in range(256)]
    items, boxes = [item_at(20.0)] * 5000, [Box(0, 0, 10, 10)] * 5000
    started = process_time()
    assert len(largest_total(similarities(CFG, tracks, items, boxes, [seen] * 5000))) == 256
    assert process_time() - started < 1.0
