"""The transforms of a result: the log's own and those of the results are one tree, in which the car is where it is."""

import numpy as np
import pytest

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.geometry import mounting, rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.model import Transform
from roadperc_stream.output import encoding
from tests import logs
from tests.replaying import replay

CFG = ReplayConfig()
FRAMES = 3
MOUNTED = logs.SMALL.ego_T_camera


def edge(parent, child, parent_T_child=None):
    return Transform(parent, child, np.eye(4) if parent_T_child is None else parent_T_child)


def place(x_m):
    return rigid(rotation_from_rpy(0.0, 0.0, 0.5), np.array([x_m, 40.0, 1.0]))


# The log's edges by frame; what joins ego to them as (parent, child); and what odom is called, above ego or below it.
TREES = {
    "our own": ([[edge("ego", "camera", MOUNTED)]], None, "odom", True),
    "no transforms": ([], ("ego", "camera"), "odom", True),
    "a car of another name": ([[edge("base_link", "camera", MOUNTED)]], ("ego", "base_link"), "odom", True),
    "a car that the log places": (
        [[edge("odom", "base_link", place(100.0)), edge("base_link", "camera", MOUNTED)]],
        ("base_link", "ego"),
        "perception_odom",
        False,
    ),
    "placed later": (
        [[edge("base_link", "camera", MOUNTED)], [], [edge("map", "base_link", place(7.0))]],
        ("base_link", "ego"),
        "perception_odom",
        False,
    ),
    "ego that the log places": (
        [[edge("map", "ego", place(5.0)), edge("ego", "camera", MOUNTED)]],
        None,
        "perception_odom",
        False,
    ),
    "a car of no known name": (
        [[edge("map", "truck", place(6.0)), edge("truck", "camera", MOUNTED)]],
        ("camera", "ego"),
        "perception_odom",
        False,
    ),
    "a camera that the log places": (
        [[edge("map", "camera", place(5.0))]],
        ("camera", "ego"),
        "perception_odom",
        False,
    ),
    "odom elsewhere": (
        [[edge("odom", "sign", place(9.0)), edge("base_link", "camera", MOUNTED)]],
        ("ego", "base_link"),
        "perception_odom",
        True,
    ),
}


def replayed(folder, tree):
    source, target = folder / "in.mcap", folder / "out.mcap"
    items = logs.items(FRAMES, roles=("calibration", "image", "depth", "segmentation"))
    stamps = [item.stamp_ns for item in items if item.role == "image"]
    messages = [
        logs.Item("tf", stamp, encoding.encode_transforms(stamp, edges))
        for stamp, edges in zip(stamps, tree, strict=False)
        if edges
    ]
    logs.write(source, sorted([*items, *messages], key=lambda item: item.stamp_ns))
    replay(source, target, CFG)
    return target


def edges_of(path, *, results):
    for message in log.read(log.summarise(path), topics=["/tf", "/perception/tf"]):
        if is_result(message.channel) == results:
            yield decode(
                "tf", "foxglove.FrameTransforms", "protobuf", message.data, message.log_time_ns, Context()
            ).payload


@pytest.mark.parametrize("name", TREES)
def test_results_extend_the_transform_tree_of_the_log(name, tmp_path):
    tree, anchor, odom, above = TREES[name]
    target = replayed(tmp_path, tree)
    written = list(edges_of(target, results=True))
    assert len(written) == FRAMES
    wanted = {(odom, "ego") if above else ("ego", odom)} | ({anchor} if anchor else set())
    for edges in written:
        assert {(found.parent, found.child) for found in edges} == wanted
    parents = {}
    joined = TransformTree()
    for edges in (*edges_of(target, results=False), *written):
        joined = joined.updated(edges)
        for found in edges:
            assert parents.setdefault(found.child, found.parent) == found.parent
    mounted = mounting(z=CFG.surface.assumed_height_m) if tree_is_silent(name) else MOUNTED
    assert joined.lookup("ego", "camera") == pytest.approx(mounted, abs=1e-9)
    (*_, last) = log.read(log.summarise(target), topics=["/perception/odometry"])
    pose = decode("pose", "foxglove.PoseInFrame", "protobuf", last.data, last.log_time_ns, Context()).payload
    assert pose.parent == odom
    assert joined.lookup(pose.parent, "ego") == pytest.approx(pose.parent_T_child, abs=1e-9)
    if name == "a car that the log places":
        assert joined.lookup("odom", "camera") == pytest.approx(place(100.0) @ MOUNTED, abs=1e-9)
        assert joined.lookup("odom", "ego") == pytest.approx(place(100.0), abs=1e-9)


def tree_is_silent(name):
    return name in ("no transforms", "a camera that the log places", "a car of no known name")


def test_without_odometry_results_are_placed_in_the_frames_of_the_log(tmp_path):
    source, target = tmp_path / "in.mcap", tmp_path / "out.mcap"
    logs.write(source, logs.items(FRAMES, roles=("calibration", "depth", "segmentation")))
    replay(source, target, CFG)
    found = list(edges_of(target, results=True))
    assert [[(e.parent, e.child) for e in edges] for edges in found] == [[("ego", "camera")]] * FRAMES
