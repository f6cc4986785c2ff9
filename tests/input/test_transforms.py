"""The tree of transforms: lookup, loops, another root."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.errors import ChannelError
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.model import Transform


def edge(parent, child, x):
    T = np.eye(4)
    T[0, 3] = x
    return Transform(parent, child, T)


def tree(*edges):
    return TransformTree().updated(edges)


def test_transforms_chain_through_the_tree():
    rig = tree(edge("ego", "rig", 1.0), edge("rig", "left", 2.0), edge("ego", "lidar", 5.0))
    assert rig.lookup("ego", "left")[0, 3] == 3.0
    assert rig.lookup("left", "lidar")[0, 3] == 2.0
    assert rig.lookup("ego", "nowhere") is None
    assert rig.updated([edge("ego", "rig", 4.0)]).lookup("ego", "left")[0, 3] == 6.0
    assert {child: e.parent for child, e in rig.edges.items()} == {"rig": "ego", "left": "rig", "lidar": "ego"}


@pytest.mark.parametrize(("frame", "known"), [("rig", True), ("ego", True), ("left", False)])
def test_frames_with_a_parent_or_children_are_known(frame, known):
    assert tree(edge("ego", "rig", 1.0)).knows(frame) == known


def test_a_loop_of_transforms_is_refused():
    with pytest.raises(ChannelError, match="frame 'a' is its own ancestor"):
        tree(edge("a", "b", 1.0), edge("b", "a", 1.0)).lookup("a", "c")


@pytest.mark.parametrize(
    ("edges", "looping"),
    [
        ([("ego", "rig")], ()),
        ([("lidar", "lidar"), ("ego", "rig")], ("lidar",)),
        ([("a", "b"), ("b", "a"), ("b", "c")], ("b", "a")),
        ([("camera", "ego")], ("ego",)),
        ([("left", "camera"), ("camera", "left")], ("camera", "left")),
        ([("rig", "ego"), ("camera", "rig"), ("rig", "odom")], ("ego", "rig")),
        ([("odom", "camera"), ("camera", "ego")], ()),
    ],
)
def test_edges_of_a_loop_are_found_before_they_are_added(edges, looping):
    known = tree(edge("ego", "camera", 1.0))
    assert known.looping([edge(parent, child, 2.0) for parent, child in edges]) == looping


frame_names = st.sampled_from("abcdef")


@given(st.lists(st.lists(st.tuples(frame_names, frame_names), max_size=8), max_size=6))
def test_without_the_edges_of_loops_a_tree_remains(messages):
    found = TransformTree()
    for message in messages:
        edges = [edge(parent, child, 1.0) for parent, child in message]
        looping = found.looping(edges)
        found = found.updated(e for e in edges if e.child not in looping)
        for name in "abcdef":
            found.lookup("a", name)


@pytest.mark.parametrize("root", ["ego", "rig", "left", "lidar", "elsewhere"])
def test_another_root_keeps_all_transforms(root):
    rig = tree(edge("ego", "rig", 1.0), edge("rig", "left", 2.0), edge("ego", "lidar", 5.0))
    turned = rig.rooted_at(root)
    assert root not in turned.edges
    for frame in ("ego", "rig", "left", "lidar"):
        np.testing.assert_allclose(turned.lookup("left", frame), rig.lookup("left", frame))
