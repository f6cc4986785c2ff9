"""Which detection is which object, whatever the order in which they come."""

from collections import Counter

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.datatypes import Box, Object
from roadperc_stream.stages.objects import tracking
from roadperc_stream.stages.objects.association import assign, similarity
from tests.analytic import box
from tests.stages.objects.frames import CFG, Follower

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


@settings(max_examples=60, deadline=None)
@given(drives, st.randoms(use_true_random=False))
def test_the_order_of_detections_decides_nothing_but_the_order_of_objects(frames, random):
    usual, shuffled, depth = Follower(), Follower(), depth_image()
    for frame in frames:
        other = random.sample(frame, len(frame))
        a, b = usual.frame(*frame, depth_m=depth), shuffled.frame(*other, depth_m=depth)
        assert Counter(a) == Counter(b)
        assert [item.detection for item in b] == other


@settings(max_examples=60, deadline=None)
@given(drives)
def test_names_are_unique_in_a_frame_and_never_given_anew(frames):
    follower, known = Follower(), set()
    for frame in frames:
        before = {track.id for track in follower.state.tracks}
        names = [item.track_id for item in follower.frame(*frame)]
        assert len(set(names)) == len(names)
        assert not (set(names) - before) & known
        known |= set(names)


def item_at(distance_m, label="Car"):
    return Object(box(label, 0, 0, 10, 10), kept=True, distance_m=distance_m, distance_std_m=0.1)


def track_at(distance_m, number=1):
    return tracking.start(CFG, number, item_at(distance_m), Box(0, 0, 10, 10), 0)


def test_contradicting_distances_count_against_a_pair():
    here = Box(0, 0, 10, 10)
    assert similarity(CFG, track_at(20.0), item_at(20.0), here) == 1.0
    assert similarity(CFG, track_at(20.0), item_at(5.0), here) == 1.0 - CFG.distance_penalty
    assert similarity(CFG, track_at(20.0), item_at(None), here) == 1.0
    assert similarity(CFG, track_at(None), item_at(20.0), here) == 1.0
    assert similarity(CFG, track_at(20.0), item_at(20.0, "Pedestrian"), here) == 0.0


def test_the_gate_is_the_least_overlap():
    quarter, fifth = Box(0, 0, 10, 2.5), Box(0, 0, 10, 1.9)
    assert similarity(CFG, track_at(20.0), item_at(20.0), quarter) == 0.25
    assert similarity(CFG, track_at(20.0), item_at(20.0), fifth) == 0.0
    assert similarity(CFG, track_at(20.0), item_at(5.0), quarter) == 0.0


def test_the_best_of_all_pairings_is_taken_not_the_best_pair_first():
    """The first detection fits both tracks, the second one only the track that the first fits better."""
    tracks = [track_at(None), tracking.start(CFG, 2, item_at(None), Box(0, 6, 10, 16), 0)]
    boxes = [Box(0, 2.5, 10, 12.5), Box(0, -6, 10, 4)]
    assert assign(CFG, tracks, [item_at(None)] * 2, boxes) == {0: 1, 1: 0}
    assert assign(CFG, tracks, [], []) == {}
    assert assign(CFG, [], [item_at(None)], [boxes[0]]) == {}
