"""A lidar's points instead of depth: their projection, the chain's results, and a log's transforms."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from roadperc_stream import geometry as g
from roadperc_stream import log
from roadperc_stream.chain.step import State
from roadperc_stream.config import ReplayConfig, load_config
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry.registration import depth_of_points
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.model import Absent, DepthImage, PointCloud, Reason, StereoDepth, Transform
from roadperc_stream.output.encoding import encode_points, encode_transforms
from roadperc_stream.output.tables import sidecar_path
from tests import logs
from tests.analytic import VEHICLE, Road, box
from tests.replaying import replay
from tests.resume.parts import write
from tests.steps import step

CFG = ReplayConfig()
ROAD = Road(pitch=0.02, roll=-0.01)
CAMERA = ROAD.camera
EGO_T_LIDAR = g.rigid(rotation_from_rpy(0.05, -0.1, 0.4), np.array([-0.3, 0.2, 2.4]))
"""A lidar behind and above the camera, with another rotation."""
REAR = slice(230, 261), slice(300, 341)
"""Rows and columns of a car's rear."""


def pixel_points(depth_m, rows=7, columns=3):
    """(N, 3) camera points of a few pixels with known depth; they project to pixel centres."""
    v, u = np.indices(depth_m.shape)
    few = np.isfinite(depth_m) & (v % rows == 0) & (u % columns == 0)
    return g.unproject(CAMERA, np.stack((u, v), axis=-1)[few].astype(float), depth_m[few].astype(float))


def cloud(camera_points, road=ROAD, ego_T_lidar=EGO_T_LIDAR, frame_id="lidar"):
    lidar_T_camera = g.inverse(ego_T_lidar) @ road.ego_T_camera
    points = g.transform(lidar_T_camera, camera_points).astype(np.float32)
    return PointCloud(frame_id, lambda: points)


def lidar_frame(index=0, road=ROAD, **changes):
    """A frame with a lidar's points of a road and of a car's rear 10 m away, without other depth."""
    depth, tags = road.depth_m(), road.tags()
    depth[REAR], tags[REAR] = 10.0, VEHICLE
    frame = road.frame(index)
    tagged = replace(frame.segmentation, decode_tags=lambda: tags)
    behind = np.array([[0.0, 0.5, -8.0], [3.0, -1.0, -20.0]])
    points = cloud(np.concatenate((pixel_points(depth), behind)), road)
    detections = (box("Car", 300, 230, 341, 261),)
    changes = {"depth_image": None, "segmentation": tagged, "points": points, "ego_T_lidar": EGO_T_LIDAR} | changes
    return replace(frame, detections=detections, **changes)


def run(frame, cfg=CFG):
    return step(cfg, State(), frame)[1]


def texts(reasons):
    return tuple(str(reason) for reason in reasons)


def test_each_point_falls_into_its_pixel_and_the_nearest_counts():
    pixels = np.array([[10.0, 20.0], [10.4, 19.6], [10.0, 20.0], [639.4, 479.4], [639.6, 5.0]])
    points = g.unproject(CAMERA, pixels, np.array([8.0, 5.0, 6.0, 30.0, 30.0]))
    points = np.concatenate((points, -points[:1], [[0.0, 0.0, 0.0]]))
    depth_m = depth_of_points(CAMERA, np.eye(4), points.astype(np.float32))
    assert depth_m.dtype == np.float32
    assert {(v, u): float(depth_m[v, u]) for v, u in np.argwhere(np.isfinite(depth_m))} == {(20, 10): 5, (479, 639): 30}
    for points in (np.empty((0, 3)), np.full((2, 3), np.finfo(np.float32).max)):
        assert np.isnan(depth_of_points(CAMERA, EGO_T_LIDAR, points.astype(np.float32))).all()


def test_plane_distance_and_lane_are_those_of_the_road_and_the_car():
    result = run(lidar_frame())
    assert result.surface.source == "lidar"
    assert result.surface.frame_id == CAMERA.frame_id
    np.testing.assert_allclose(result.surface.plane.n, ROAD.plane.n, atol=1e-6)
    assert result.surface.camera_height_m == pytest.approx(ROAD.height_m, abs=1e-6)
    (item,) = result.objects.objects
    assert item.kept
    assert item.distance_m == pytest.approx(10.0 * np.linalg.norm(g.rays(CAMERA, np.array([318.0, 238.0]))), abs=1e-3)
    assert not item.beyond_range
    for side, offset in (("left", ROAD.left_m), ("right", ROAD.right_m)):
        assert result.lanes.side(side).status == "measured"
        assert result.lanes.side(side).offset_m == pytest.approx(offset, abs=0.05)


def few_on_the_road(count):
    """``count`` points of the road, and those of the car's rear."""
    depth_m = ROAD.depth_m()
    rear = np.full_like(depth_m, np.nan)
    rear[REAR] = 10.0
    v, u = np.array([420, 440, 460][:count], int), np.array([300, 500, 240][:count], int)
    road_points = g.unproject(CAMERA, np.stack((u, v), axis=-1).astype(float), depth_m[v, u].astype(float))
    return cloud(np.concatenate((pixel_points(rear), road_points)))


@pytest.mark.parametrize(
    ("count", "mounted", "source"),
    [(0, True, "the mounting"), (2, True, "the mounting"), (2, False, "the assumed height")],
)
def test_a_lidar_that_misses_the_road_gives_the_assumed_plane_and_distances(count, mounted, source):
    result = run(lidar_frame(points=few_on_the_road(count), mounted=mounted))
    few = f"{count} road pixels with known depth within max_depth_m, a plane needs three"
    assert texts(result.problems) == (f"surface: {source} gives the plane: {few}",)
    assert result.surface.source == "assumed"
    assert result.lanes.side("left").status == "measured"
    assert result.objects.objects[0].distance_m == pytest.approx(10.1, abs=0.3)


def test_collinear_points_and_points_beyond_the_range_give_the_assumed_plane():
    """Points of one ring of a lidar, for example, are collinear."""
    road_points = g.intersect_plane(CAMERA, np.array([[200.0, 420.0], [300.0, 420.0], [400.0, 420.0]]), ROAD.plane)
    result = run(lidar_frame(points=cloud(road_points), mounted=True))
    assert result.surface.source == "assumed"
    assert texts(result.problems) == (
        "surface: the mounting gives the plane: no plane through 3 road points fits 20% of them",
    )
    result = run(lidar_frame(), load_config(None, ("surface.max_depth_m=1",)))
    assert result.surface.source == "assumed"
    assert result.problems[0].cause == Reason("surface", "too_few_road_points", (0,))


@pytest.mark.parametrize("mounted", [True, False])
def test_a_depth_camera_that_misses_the_road_gives_the_mountings_plane_or_none(mounted):
    depth_m = np.full_like(ROAD.depth_m(), np.nan)
    depth_m[400:402, 320] = 3.0
    depth = DepthImage(CAMERA.frame_id, lambda: (depth_m, np.inf))
    result = run(lidar_frame(points=None, depth_image=depth, mounted=mounted))
    missed = Reason("surface", "too_few_road_points", (2,))
    if mounted:
        assert result.surface.source == "assumed"
        assert result.lanes.side("left").status == "measured"
        assert Reason("surface", "plane_assumed", ("the mounting",), missed) in result.problems
        assert result.occupancy == Absent(Reason("occupancy", "heights_unknown"))
    else:
        assert result.surface == Absent(missed)
        assert result.drivable == Absent(Reason("drivable", "no_surface", cause=missed))


def test_the_drivable_pixels_are_dense():
    frame = lidar_frame()
    dense = run(replace(frame, points=None, depth_image=ROAD.frame().depth_image))
    sparse = run(frame)
    both, either = np.sum(dense.drivable & sparse.drivable), np.sum(dense.drivable | sparse.drivable)
    assert both / either > 0.98


def test_the_spline_uses_every_point():
    result = run(lidar_frame(), load_config(None, ("surface.model=spline",)))
    assert result.surface.model == "spline"
    x = np.arange(41)
    np.testing.assert_allclose(result.surface.height_grid.z_m[10, x], 0.0, atol=0.01)


def test_the_grid_is_free_on_the_road_and_occupied_by_the_car():
    grid = run(lidar_frame()).occupancy
    x = ((np.arange(grid.cells.shape[1]) + 0.5) * grid.resolution_m) + grid.x_min_m
    ahead = np.abs((np.arange(grid.cells.shape[0]) + 0.5) * grid.resolution_m + grid.y_min_m) < 0.3
    assert (grid.cells[ahead][:, (x > 3) & (x < 9)] == 0).all()
    assert (grid.cells[ahead][:, (x > 9.7) & (x < 10.3)] == 100).any()


def test_without_segmentation_the_lower_image_gives_the_plane():
    result = run(lidar_frame(segmentation=None))
    assert result.surface.source == "lower_image"
    assert result.surface.camera_height_m == pytest.approx(ROAD.height_m, abs=1e-3)
    assert result.drivable == Absent(Reason("drivable", "no_segmentation_sparse_depth"))


def test_a_depth_sensor_comes_first_then_stereo_then_the_lidar(monkeypatch):
    frame = lidar_frame(points=PointCloud("lidar", broken), depth_image=ROAD.frame().depth_image)
    assert run(frame).surface.source == "depth"
    assert not run(frame).problems, "the points are not decoded"
    frame = lidar_frame()
    failing = DepthImage(CAMERA.frame_id, broken)
    assert run(replace(frame, depth_image=failing)).surface.source == "lidar"
    depth_m = ROAD.depth_m()
    monkeypatch.setattr("roadperc_stream.chain.prepare._stereo", lambda *_: StereoDepth(CAMERA.frame_id, depth_m))
    assert run(replace(frame, depth_image=failing)).surface.source == "stereo"


def broken(*_):
    raise DecodeError("cut off")


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"points": PointCloud("lidar", broken)}, "lidar: cannot be decoded: cut off"),
        ({"ego_T_lidar": None}, "lidar: no transform connects its frame 'lidar' with ego"),
        ({"points": PointCloud("lidar", lambda: np.zeros((0, 3), np.float32))}, "lidar: none of its 0 points is in"),
        (
            {"points": PointCloud("lidar", lambda: np.float32([[np.nan, 0, 0], [0, np.inf, 0], [-9, 0, 0]]))},
            "lidar: none of its 3 points is in the camera's view; 2 of them are not finite",
        ),
    ],
)
def test_points_that_cannot_be_used_are_missing_and_reported(changes, problem):
    result = run(lidar_frame(**changes))
    assert str(result.problems[0]).startswith(problem)
    assert str(result.problems[1]) == "surface: no depth, the mounting gives the plane"
    assert result.surface.source == "assumed"
    assert result.objects.objects[0].distance_m is None


SMALL = logs.SMALL
ROLES = tuple(role for role in logs.ALL if role != "depth")


def log_of(path, ego_T_lidar, frame_id="lidar", edges=(), roles=ROLES, frames=2):
    """A log with a lidar as its only depth; its points are in a frame with the pose ``ego_T_lidar``."""
    items = logs.items(frames, roles=roles)
    if edges:
        items.insert(0, logs.Item("tf", logs.START_NS, encode_transforms(logs.START_NS, edges)))
    depth_m = SMALL.depth_m()
    v, u = np.indices(depth_m.shape)
    seen = np.isfinite(depth_m) & (v % 5 == 0)
    points = g.unproject(SMALL.camera, np.stack((u, v), axis=-1)[seen].astype(float), depth_m[seen].astype(float))
    points = g.transform(g.inverse(ego_T_lidar) @ SMALL.ego_T_camera, points).astype(np.float32)
    for stamp in sorted({item.stamp_ns for item in items}):
        items.append(logs.Item("lidar", stamp, encode_points(stamp, frame_id, points)))
    return logs.write(path, sorted(items, key=lambda item: item.stamp_ns))


def replayed(source, name="out.mcap", **options):
    target = source.parent / name
    replay(source, target, ReplayConfig(), **options)
    return target, pl.read_parquet(sidecar_path(target, "metrics"))


RIG = g.rigid(rotation_from_rpy(0.0, 0.0, -0.5), np.array([1.0, 0.0, 1.0]))


@pytest.mark.parametrize(
    ("edges", "frame_id", "ego_T_points"),
    [
        ([Transform("ego", "lidar", EGO_T_LIDAR)], "lidar", EGO_T_LIDAR),
        ([Transform("ego", "rig", RIG), Transform("rig", "lidar", g.inverse(RIG) @ EGO_T_LIDAR)], "lidar", EGO_T_LIDAR),
        ([Transform("camera", "lidar", g.inverse(SMALL.ego_T_camera) @ EGO_T_LIDAR)], "lidar", EGO_T_LIDAR),
        ([], "camera", SMALL.ego_T_camera),
        ([], "ego", np.eye(4)),
    ],
)
def test_the_transform_tree_places_the_points(tmp_path, edges, frame_id, ego_T_points):
    _, table = replayed(log_of(tmp_path / "in.mcap", ego_T_points, frame_id, edges))
    assert set(table["surface_source"]) == {"lidar"}
    np.testing.assert_allclose(table["camera_height_m"], SMALL.height_m, atol=1e-3)
    assert set(table["lane_left_status"]) == {"measured"}


def test_a_frame_outside_the_tree_is_reported(tmp_path):
    _, table = replayed(log_of(tmp_path / "in.mcap", EGO_T_LIDAR, "roof"))
    assert table["surface_source"].to_list() == ["assumed", "estimated"]
    assert table["missing"].to_list() == [[]] * 2
    for reasons in table["reasons"].to_list():
        assert {"source": "lidar", "code": "no_transform", "values": ["roof"], "cause": ""} in reasons


def test_a_lidar_slower_than_the_camera_is_missing_in_between(tmp_path):
    source = log_of(tmp_path / "in.mcap", np.eye(4), "ego", frames=4)
    kept = [
        m
        for m in log.read(log.summarise(source))
        if m.channel.topic != "/lidar/points" or m.log_time_ns % (2 * logs.STEP_NS) == 0
    ]
    _, table = replayed(write(tmp_path / "half.mcap", kept), "half_out.mcap")
    assert table["missing"].to_list() == [[], ["lidar"], [], ["lidar"]]
    assert table["surface_source"].to_list() == ["lidar", "estimated", "lidar", "estimated"]


@pytest.mark.parametrize(
    ("frames_before", "edges"),
    [(0, [("lidar", "lidar")]), (0, [("camera", "ego")]), (1, [("a", "b"), ("b", "a")]), (1, [("camera", "ego")])],
)
def test_a_loop_of_transforms_is_left_out_and_reported_with_topic_and_stamp(tmp_path, frames_before, edges):
    """The earlier transforms stay valid, for a loop before the first frame and for a later one."""
    source = log_of(tmp_path / "in.mcap", EGO_T_LIDAR, edges=[Transform("ego", "lidar", EGO_T_LIDAR)])
    loop = encode_transforms(logs.START_NS, [Transform(parent, child, np.eye(4)) for parent, child in edges])
    stamp = logs.START_NS + frames_before * logs.STEP_NS
    message = log.Message(logs.channel("tf"), stamp, stamp, 0, loop)
    looped = write(tmp_path / "loop.mcap", [*log.read(log.summarise(source)), message])
    summary = replay(looped, tmp_path / "out.mcap", ReplayConfig())
    parent, child = edges[0]
    (note,) = summary.notes
    assert note.startswith(f"/tf: message at {stamp} ns: a loop of transforms ({parent!r} to {child!r}")
    table = pl.read_parquet(sidecar_path(tmp_path / "out.mcap", "metrics"))
    assert table["surface_source"].to_list() == ["lidar"] * 2


def renamed(source, name, topics):
    """The log with its lidar's messages on other topics."""
    with log.LogWriter(source.parent / name) as writer:
        for message in log.read(log.summarise(source)):
            for topic in topics if message.channel.topic == "/lidar/points" else (message.channel.topic,):
                writer.write(replace(message, channel=replace(message.channel, topic=topic)))
    return source.parent / name


def test_points_of_unassigned_topics_are_reported_and_not_used(tmp_path):
    source = log_of(tmp_path / "in.mcap", np.eye(4), "ego")
    others = renamed(source, "others.mcap", ("/velodyne", "/rear", "/side", "/top"))
    summary = replay(others, tmp_path / "out.mcap", ReplayConfig())
    candidates = ", ".join(f"{topic} (foxglove.PointCloud)" for topic in ("/rear", "/side", "/top"))
    assert summary.notes == (f"role lidar: not assigned; candidates: {candidates}, ...: --topic lidar=/rear",)
    table = pl.read_parquet(sidecar_path(tmp_path / "out.mcap", "metrics"))
    assert set(table["surface_source"]) == {"assumed", "estimated"}
    both = renamed(source, "both.mcap", ("/lidar/points", "/velodyne"))
    assert replay(both, tmp_path / "both_out.mcap", ReplayConfig()).notes == ()
    _, table = replayed(others, "assigned.mcap", overrides={"lidar": "/velodyne"})
    assert set(table["surface_source"]) == {"lidar"}
