"""Channel by channel: what Rerun's own importer makes of an output log, and what it does not draw."""

from pathlib import Path

import pytest

from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.schemas.topics import RESULTS
from tests import logs
from tests.view.rerun.chunks import imported

SAMPLE = Path(__file__).parents[3] / "logs" / "sample.mcap"
WARNED = "/perception/log"
DRAWN = {
    "/camera/front/image": {"EncodedImage", "CoordinateFrame"},
    "/camera/right/image": {"EncodedImage", "CoordinateFrame"},
    "/camera/front/segmentation": {"EncodedImage", "CoordinateFrame"},
    "/camera/front/calibration": {"Pinhole"},
    "/camera/right/calibration": {"Pinhole"},
    "/camera/front/depth": {"DepthImage", "CoordinateFrame"},
    "/tf": {"Transform3D"},
    "/truth/pose": {"InstancePoses3D", "CoordinateFrame"},
    "/truth/depth": {"DepthImage", "CoordinateFrame"},
    "/truth/segmentation": {"EncodedImage", "CoordinateFrame"},
    "/perception/drivable": {"EncodedImage", "CoordinateFrame"},
    "/perception/occupancy": {"GridMap", "CoordinateFrame"},
    "/perception/stereo/depth": {"DepthImage", "CoordinateFrame"},
    "/perception/odometry": {"InstancePoses3D", "CoordinateFrame"},
    "/perception/trajectory": {"InstancePoses3D", "CoordinateFrame"},
    "/perception/tf": {"Transform3D"},
    "/perception/log": {"TextLog"},
}
NOT_DRAWN = {
    "/camera/front/detections": "roadperc.Detections",
    "/truth/surface": "roadperc.Surface",
    "/truth/lanes": "roadperc.Lanes",
    "/truth/objects": "roadperc.Objects",
    "/perception/surface": "roadperc.Surface",
    "/perception/drivable/scene": "foxglove.SceneUpdate",
    "/perception/lanes": "roadperc.Lanes",
    "/perception/lanes/annotations": "foxglove.ImageAnnotations",
    "/perception/lanes/scene": "foxglove.SceneUpdate",
    "/perception/objects": "roadperc.Objects",
    "/perception/objects/annotations": "foxglove.ImageAnnotations",
    "/perception/objects/scene": "foxglove.SceneUpdate",
    "/perception/odometry/state": "roadperc.Odometry",
    "/perception/metrics": "roadperc.FrameMetrics",
}
ABOUT_CHANNELS = {"McapChannel", "McapSchema", "rerun.controls.RowId"}


@pytest.fixture(scope="module")
def entities(tmp_path_factory):
    """The sample's first frames; they give no reason to warn, so the log's line is one of a log without stereo."""
    folder = tmp_path_factory.mktemp("imported")
    mono = logs.write(folder / "mono.mcap", logs.items(frames=2))
    assert replay_main([str(SAMPLE), str(folder / "out.mcap"), "--quiet", "--frames", "3"]) == 0
    assert replay_main([str(mono), str(folder / "mono-out.mcap"), "--quiet"]) == 0
    return imported(folder / "out.mcap") | {WARNED: imported(folder / "mono-out.mcap")[WARNED]}


def test_every_result_channel_is_judged():
    assert set(RESULTS) <= set(DRAWN) | set(NOT_DRAWN)


@pytest.mark.parametrize("topic", DRAWN)
def test_rerun_draws(entities, topic):
    assert entities[topic].archetypes - ABOUT_CHANNELS == DRAWN[topic]


@pytest.mark.parametrize("topic", NOT_DRAWN)
def test_rerun_does_not_draw(entities, topic):
    assert entities[topic].archetypes - ABOUT_CHANNELS == {NOT_DRAWN[topic]}
