"""The enabled stages decode the images that they need, in ``observe``, and no others."""

from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream.chain.step import ChainState, localise, observe, perceive, step
from roadperc_stream.config import STAGES, load_config, switched_off
from roadperc_stream.errors import DecodeError
from roadperc_stream.model import Absent, CameraImage, DepthImage, InstanceImage, PointCloud, TagImage
from roadperc_stream.schemas.topics import NEEDS
from tests.analytic import STEP_NS, box
from tests.logs import SMALL

GREY = np.random.default_rng(0).integers(0, 255, (SMALL.height, SMALL.width), np.uint8)
SCENE = {"tags", "depth"}
DECODED = {
    "stereo": {"image", "right"},
    "surface": SCENE,
    "odometry": SCENE | {"image"},
    "lanes": SCENE,
    "objects": SCENE | {"instances", "image"},
    "occupancy": SCENE,
}
"""Decoded images with one stage enabled, and the stages that it needs."""


def only(*stages):
    """The configuration of ``--only``."""
    wanted = {*stages, *(needed for stage in stages for needed in NEEDS.get(stage, ()))}
    return load_config(None, tuple(switched_off(stage) for stage in STAGES if stage not in wanted))


def watched(read, **without):
    """A frame with all inputs; its images append their names to ``read`` when they are decoded."""
    frame = SMALL.frame(0, detections=(box("Car", 20, 60, 60, 90),))
    ids, tags, depth_m = np.zeros(GREY.shape, np.uint16), SMALL.tags(), SMALL.depth_m()
    points_m = np.array([[0.0, 1.0, 10.0]], np.float32)

    def noting(name, pixels):
        return lambda: (read.append(name), pixels.copy() if isinstance(pixels, np.ndarray) else pixels)[1]

    def camera(name):
        return CameraImage("camera", noting(f"{name} in colour", GREY), noting(name, GREY))

    full = replace(
        frame,
        image=camera("image"),
        right=camera("right"),
        right_camera=replace(frame.camera, baseline_m=0.5),
        depth=DepthImage("camera", noting("depth", (depth_m, np.inf))),
        segmentation=TagImage("camera", frame.segmentation.table, noting("tags", tags)),
        instances=InstanceImage("camera", noting("instances", ids)),
        points=PointCloud("camera", noting("points", points_m)),
        ego_T_lidar=frame.ego_T_camera,
    )
    return replace(full, **without)


@pytest.mark.parametrize("stage", STAGES)
def test_observe_decodes_all_images_that_a_stage_needs(stage):
    read, cfg, start = [], only(stage), ChainState()
    scene = observe(cfg, watched(read))
    assert sorted(read) == sorted(DECODED[stage]), "each once"
    perceive(cfg, start, localise(cfg, start, scene))
    assert sorted(read) == sorted(DECODED[stage]), "later steps decode none"


@pytest.mark.parametrize("stages", [STAGES, ("stereo", "objects"), ("odometry", "objects"), ()])
@pytest.mark.parametrize("without", [(), ("depth",), ("depth", "right"), ("right_camera",), ("image",)])
def test_a_whole_step_decodes_the_same(stages, without):
    first, alone, cfg = [], [], only(*stages)
    observe(cfg, watched(first, **dict.fromkeys(without)))
    step(cfg, ChainState(), watched(alone, **dict.fromkeys(without)))
    assert sorted(first) == sorted(alone)


def searching():
    """Objects alone, and the state after a frame with one."""
    cfg, frame = only("objects"), watched([])
    tags, table = SMALL.tags(), frame.segmentation.table
    tags[60:90, 20:60] = table.tags_of(("vehicle",))[0]
    frame = replace(frame, segmentation=TagImage("camera", table, lambda: tags), instances=None)
    return cfg, step(cfg, ChainState(), frame)[0]


def test_the_image_is_decoded_for_a_track_without_a_detection():
    (cfg, state), read, idle = searching(), [], []
    assert state.objects.tracks
    later = {"stamp_ns": state.stamp_ns + STEP_NS, "detections": ()}
    step(cfg, state, watched(read, **later))
    assert sorted(read) == sorted(DECODED["objects"])
    step(cfg, ChainState(), watched(idle, **later))
    assert sorted(idle) == sorted(DECODED["objects"] - {"image"}), "no track is searched"


def test_an_undecodable_image_that_a_track_needs_is_reported_after_the_other_images():
    def fails():
        raise DecodeError("no image")

    cfg, state = searching()
    frame = watched([], stamp_ns=state.stamp_ns + STEP_NS, detections=(), depth=None, points=None)
    tags = TagImage("camera", frame.segmentation.table, fails)
    frame = replace(frame, segmentation=tags, image=CameraImage("camera", fails, fails))
    _, result = step(cfg, state, frame)
    undecodable = [reason.source for reason in result.reasons() if reason.code == "undecodable"]
    assert undecodable == ["segmentation", "image"]


def test_without_depth_the_points_of_a_lidar_are_decoded():
    read, cfg = [], only("surface")
    observe(cfg, watched(read, depth=None))
    assert sorted(read) == ["points", "tags"]


def test_stereo_alone_reports_no_problems_of_other_stages():
    frame = watched([], depth=None, segmentation=None)
    _, result = step(only("stereo"), ChainState(), frame)
    others = (result.surface, result.lanes, result.objects, result.odometry, result.occupancy)
    assert {reason.code for reason in result.reasons() if reason.source != "stereo"} == {"switched_off"}
    assert all(isinstance(output, Absent) for output in others)
