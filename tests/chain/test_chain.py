"""The chain on analytic frames with missing, unusual or disabled inputs."""

from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages.surface.road import KnownPitch, assumed_surface
from roadperc_stream.chain.step import State, _on_other_plane, _with_known_height
from roadperc_stream.config import STAGES, ReplayConfig, load_config, switched_off
from roadperc_stream.errors import DecodeError
from roadperc_stream.model import Absent, CameraImage, DepthImage, Reason, TagImage
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE
from roadperc_stream.system.progress import StageTimer
from tests.analytic import ROAD, Road, box
from tests.logs import SMALL, shifted
from tests.steps import step

CFG = ReplayConfig()


def drive(count=5):
    detections = (box("Car", 20, 60, 60, 90),)
    return [shifted(SMALL, k).frame(k, detections=detections) for k in range(count)]


def run(frames, state=None, cfg=CFG):
    results = []
    state = state or State()
    for frame in frames:
        state, result = step(cfg, state, frame)
        results.append(result)
    return state, results


def texts(reasons):
    return tuple(str(reason) for reason in reasons)


def same(a, b):
    """Equal in every field, arrays bit for bit."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b


def test_a_disabled_stage_has_no_time():
    timer, cfg = StageTimer(), load_config(settings=[switched_off(stage) for stage in STAGES if stage != "surface"])
    step(cfg, State(), *drive(1), timer)
    assert set(timer.columns()) == {"decode_ms", "surface_ms"}


def test_a_frame_without_depth_tags_and_detections_has_an_assumed_road():
    bare = replace(drive(1)[0], depth_image=None, segmentation=None, detections=None)
    _, (result,) = run([bare])
    assert result.surface.source == "assumed"
    assert isinstance(result.drivable, Absent)
    assert isinstance(result.lanes, Absent)


def broken(*_):
    raise DecodeError("cut off")


@pytest.mark.parametrize(
    ("changes", "source", "problems"),
    [
        (
            {"segmentation": TagImage("camera", TABLE, broken), "depth_image": DepthImage("camera", broken)},
            "assumed",
            (
                "segmentation: cannot be decoded: cut off",
                "depth: cannot be decoded: cut off",
                "surface: no depth, the mounting gives the plane",
                "objects: no segmentation, detections are not filtered",
                "objects: no depth, the boxes' lower edges on the road give the distances",
            ),
        ),
        (
            {"segmentation": TagImage("camera", TABLE, Road(width=100, height=50).tags)},
            "lower_image",
            (
                "segmentation: 100x50 pixels, its calibration says 320x240",
                "surface: no segmentation, the lower image is used as the road",
                "objects: no segmentation, detections are not filtered",
            ),
        ),
    ],
    ids=["undecodable", "of another size than the calibration"],
)
def test_an_unusable_input_counts_as_missing_and_is_reported(changes, source, problems):
    _, (result,) = run([replace(drive(1)[0], **changes)])
    assert texts(result.problems) == problems
    assert result.surface.source == source


@pytest.mark.parametrize(
    ("to_ns", "code"),
    [(lambda last: last - 1, "time_went_back"), (lambda last: last + 3600 * 10**9 + 1, "time_jumped")],
    ids=["back", "more than an hour ahead"],
)
def test_a_stamp_that_begins_a_segment_clears_the_state(to_ns, code):
    frames = drive(5)
    last_ns = frames[3].stamp_ns
    _, results = run([*frames[:4], replace(frames[4], stamp_ns=to_ns(last_ns))])
    assert Reason("time", code, (last_ns, to_ns(last_ns))) in results[-1].problems
    assert results[-1].lanes.side("left").status == "measured"


def test_odometry_is_lost_with_an_unusable_image_and_absent_without_an_image():
    without = drive(1)[0]
    _, (absent,) = run([replace(without, image=None)])
    assert absent.odometry == Absent(Reason("odometry", "no_image"))
    _, (lost,) = run([replace(without, image=CameraImage("camera", broken, broken))])
    assert lost.odometry.status == "lost"
    assert "odometry: lost, its image cannot be used" in texts(lost.reasons())


def test_arrays_are_read_only():
    _, (result,) = run(drive(1))
    with pytest.raises(ValueError, match="read-only"):
        result.lanes.proposals_px[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        drive(1)[0].segmentation.tags[0] = 0


def test_a_depth_camera_below_the_image_camera():
    """The camera height is the depth camera's; the drivable pixels are in the front image."""
    road, lower = SMALL, replace(SMALL, height_m=1.2)
    depth = lower.depth_m()
    depth_camera = replace(road.camera, frame_id="depth")
    frame = replace(
        road.frame(),
        depth_camera=depth_camera,
        ego_T_depth_camera=lower.ego_T_camera,
        depth_image=DepthImage("depth", lambda: (depth, 65.535)),
    )
    _, (result,) = run([frame])
    assert result.surface.camera_height_m == pytest.approx(1.2, abs=1e-3)
    road_pixels = road.tags() == ROAD
    near = road_pixels & (road.ground()[1][..., 0] < 25)
    assert (result.drivable & near).sum() > 0.95 * near.sum()
    assert not (result.drivable & ~np.isin(road.tags(), (6, ROAD))).any()
    assert result.lanes.side("left").offset_m == pytest.approx(road.left_m, abs=0.05)


def test_roll_and_pitch_of_the_mounting_do_not_move_the_lane():
    tilted = Road(pitch=0.06, roll=0.03, width=640, height=480)
    _, (result,) = run([tilted.frame()])
    assert result.lanes.side("left").offset_m == pytest.approx(1.8, abs=0.05)
    np.testing.assert_allclose(result.surface.ego_plane.n, (0, 0, 1), atol=1e-3)
    assert g.angle_between(result.surface.plane.n, tilted.plane.n) < 1e-3


@pytest.mark.parametrize(("fy_over_fx", "reported"), [(1.0, False), (1.04, False), (0.75, True), (1.06, True)])
def test_a_front_camera_that_is_not_rectified_or_has_no_square_pixels_is_reported(fy_over_fx, reported):
    (frame,) = drive(1)
    camera = replace(frame.camera, fy=frame.camera.fx * fy_over_fx)
    lens = g.Lens(camera.fx, camera.fy, camera.cx, camera.cy) if reported else None
    _, (result,) = run([replace(frame, camera=replace(camera, lens=lens))])
    assert (Reason("image", "pixels_not_square", (camera.fx, camera.fy)) in result.problems) == reported
    assert (Reason("image", "not_rectified") in result.problems) == reported


@pytest.mark.parametrize(
    ("source", "mounted", "used"),
    [("depth", False, True), ("depth", True, True), ("assumed", False, False), ("assumed", True, True)],
)
def test_a_road_gives_the_scale_if_depth_or_the_mounting_gives_its_height(source, mounted, used):
    road = replace(assumed_surface(SMALL.camera, SMALL.ego_T_camera), source=source)
    assert _with_known_height(SimpleNamespace(mounted=mounted), road) is (road if used else None)
    assert _with_known_height(SimpleNamespace(mounted=mounted), Absent(Reason("surface", "no_depth"))) is None


@pytest.mark.parametrize(
    ("source", "before", "now", "other"),
    [
        ("estimated", None, 2.0, True),
        ("assumed", 2.0, None, True),
        ("estimated", None, 0.3, False),  # the mounting was right
        ("estimated", 0.0, 2.0, False),  # the car has pitched, and its boundaries with it
        ("depth", None, 2.0, False),
        ("held", None, 2.0, False),
    ],
)
def test_boundaries_of_an_assumed_plane_do_not_fit_the_plane_of_a_pitch_just_shown(source, before, now, other):
    road = replace(assumed_surface(SMALL.camera, SMALL.ego_T_camera), source=source)
    pitches = [None if deg is None else KnownPitch(np.deg2rad(deg), 1e-6, "the motion") for deg in (before, now)]
    assert _on_other_plane(road, *pitches) == other
    assert not _on_other_plane(Absent(Reason("surface", "no_depth")), *pitches)
