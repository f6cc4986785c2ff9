"""What holds until replaced: cameras and transforms, but for edges that would close a loop."""

import numpy as np

from roadperc_stream.core.datatypes import Transform
from roadperc_stream.core.geometry import Camera
from roadperc_stream.input.latched import LatchedState, without_loops
from roadperc_stream.input.problems import Problems
from roadperc_stream.input.stream import Stamped

CAMERA = Camera("camera", 10, 10, 5.0, 5.0, 4.5, 4.5)


def message(*edges, log_time_ns=0):
    return Stamped("tf", log_time_ns, 0, tuple(Transform(parent, child, np.eye(4)) for parent, child in edges))


def test_cameras_and_transforms_are_latched_side_by_side():
    state = LatchedState().updated(Stamped("calibration", 0, 0, CAMERA)).updated(message(("ego", "camera")))
    assert (state.cameras, state.tree.parent_of) == ({"calibration": CAMERA}, {"camera": "ego"})


def test_what_closes_a_loop_is_left_out_and_reported_once_a_topic():
    problems = Problems()
    items = [
        message(("ego", "camera")),
        message(("camera", "ego"), log_time_ns=5),
        message(("camera", "ego"), ("ego", "lidar"), log_time_ns=6),
        Stamped("calibration", 7, 7, CAMERA),
    ]
    kept = list(without_loops(items, LatchedState(), {"tf": "/tf", "calibration": "/c"}, problems))
    assert [[edge.child for edge in item.edges] for item in kept] == [["camera"], ["lidar"], []]
    (text,) = problems.first.values()
    assert text == "/tf: message at 5 ns: a loop of transforms ('camera' to 'ego'), expected a tree: left out"
    assert not problems.counts
