"""``prepare`` decodes the images that the enabled stages need, and no others; the stages decode none."""

from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream.chain.prepare import prepare
from roadperc_stream.chain.step import State, step
from roadperc_stream.config import STAGES, load_config, switched_off
from roadperc_stream.errors import DecodeError
from roadperc_stream.model import Absent, CameraImage, DepthImage, InstanceImage, PointCloud, TagImage
from roadperc_stream.schemas.topics import NEEDS
from tests.analytic import box
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
        depth_image=DepthImage("camera", noting("depth", (depth_m, np.inf))),
        segmentation=TagImage("camera", frame.segmentation.table, noting("tags", tags)),
        instance_image=InstanceImage("camera", noting("instances", ids)),
        points=PointCloud("camera", noting("points", points_m)),
        ego_T_lidar=frame.ego_T_camera,
    )
    return replace(full, **without)


@pytest.mark.parametrize("stage", STAGES)
def test_all_images_that_a_stage_needs_are_decoded_before_it(stage):
    read, cfg = [], only(stage)
    frame = prepare(cfg, watched(read))
    assert sorted(read) == sorted(DECODED[stage]), "each once"
    step(cfg, State(), frame)
    assert sorted(read) == sorted(DECODED[stage]), "later steps decode none"


def test_undecodable_images_are_missing_with_a_reason():
    def fails():
        raise DecodeError("no image")

    frame = watched([], depth_image=None, points=None)
    tags = TagImage("camera", frame.segmentation.table, fails)
    cfg, frame = only("objects"), replace(frame, segmentation=tags, image=CameraImage("camera", fails, fails))
    frame = prepare(cfg, frame)
    assert (frame.tags, frame.grey) == (None, None)
    _, result = step(cfg, State(), frame)
    undecodable = [reason.source for reason in result.reasons() if reason.code == "undecodable"]
    assert undecodable == ["segmentation", "image"]


def test_without_depth_the_points_of_a_lidar_are_decoded():
    read, cfg = [], only("surface")
    prepare(cfg, watched(read, depth_image=None))
    assert sorted(read) == ["points", "tags"]


def test_stereo_alone_reports_no_problems_of_other_stages():
    frame = watched([], depth_image=None, segmentation=None)
    cfg = only("stereo")
    _, result = step(cfg, State(), prepare(cfg, frame))
    others = (result.surface, result.lanes, result.objects, result.odometry, result.occupancy)
    assert {reason.code for reason in result.reasons() if reason.source != "stereo"} == {"switched_off"}
    assert all(isinstance(output, Absent) for output in others)
