"""Places of images, boxes, road and map in a recording, from its pinholes and transforms."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.config import load_config
from roadperc_stream.geometry import Camera, inverse, mounting, project, rays, rigid, transform
from roadperc_stream.model import Transform
from roadperc_stream.output.encoding import encode_transforms
from roadperc_stream.view.rerun import save_recording
from tests import logs
from tests.view.rerun.chunks import recorded
from tests.view.rerun.conftest import FRAMES

CALIBRATION = "/camera/front/calibration"


def shown(entities, entity, frame):
    """The last value of each column of an entity at a frame."""
    cells = {}
    for row in sorted(entities[entity].rows, key=lambda row: row["message_log_time"]):
        if row["frame"] <= frame:
            cells |= {name: cell for name, cell in row.items() if cell is not None}
    return cells


def ego_T(entities, frame_id, frame):
    """The pose of a coordinate frame from the transforms at a frame; each has one entity and one parent."""
    edges = {}
    for entity in entities:
        cells = shown(entities, entity, frame)
        if "Transform3D:child_frame" in cells:
            (child,) = cells["Transform3D:child_frame"]
            assert child not in edges
            rotation = np.array(cells["Transform3D:mat3x3"][0]).reshape(3, 3, order="F")
            edges[child] = cells["Transform3D:parent_frame"][0], rigid(rotation, cells["Transform3D:translation"][0])
    ego_T_frame = np.eye(4)
    while frame_id != "ego":
        frame_id, parent_T_frame = edges[frame_id]
        ego_T_frame = parent_T_frame @ ego_T_frame
    return ego_T_frame


def front(entities):
    """Rerun's camera, with pixels counted from the image corner, and ego_T_camera at the first frame."""
    cells = shown(entities, CALIBRATION, 0)
    K = np.array(cells["Pinhole:image_from_camera"][0]).reshape(3, 3, order="F")
    (frame_id,), (size,) = cells["Pinhole:parent_frame"], cells["Pinhole:resolution"]
    camera = Camera(frame_id, int(size[0]), int(size[1]), K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    return camera, ego_T(entities, frame_id, 0)


@pytest.mark.parametrize("frame", range(FRAMES))
def test_lanes_in_3d_project_onto_lanes_in_the_image(saved, frame):
    camera, ego_T_camera = front(saved)
    on_road = shown(saved, "/perception/lanes/scene", frame)["LineStrips3D:strips"]
    in_image = shown(saved, "/perception/lanes/annotations/smoothed", frame)["LineStrips2D:strips"]
    assert len(on_road) == len(in_image) == 2
    for line_m, line_px in zip(on_road, in_image, strict=True):
        seen = project(camera, transform(inverse(ego_T_camera), np.array(line_m)))
        inside = seen[((seen >= 0.1) & (seen <= (camera.width - 0.1, camera.height - 0.1))).all(axis=1)]
        away_px = np.linalg.norm(inside[:, None] - np.array(line_px), axis=-1).min(axis=1)
        assert len(inside) > 10
        assert away_px.max() < 0.01


@pytest.mark.parametrize("frame", range(FRAMES))
def test_boxes_in_3d_project_onto_boxes_in_the_image(saved, frame):
    camera, _ = front(saved)
    space = shown(saved, "/perception/objects/scene", frame)
    image = shown(saved, "/perception/objects/annotations/kept", frame)
    assert space["CoordinateFrame:frame"] == [camera.frame_id]
    named = list(zip(image["Boxes2D:labels"], corners(image, "Boxes2D"), strict=True))
    assert space["Boxes3D:labels"]
    for text, (low, high) in zip(space["Boxes3D:labels"], corners(space, "Boxes3D"), strict=True):
        low[2] = high[2] = (low[2] + high[2]) / 2
        seen = project(camera, np.array([low, high]))
        assert min(abs(box_px - seen).max() for label, box_px in named if label == text) < 0.01


def corners(cells, archetype):
    """(N, 2, D) smallest and largest corners."""
    centres, halves = (np.array(cells[f"{archetype}:{name}"]) for name in ("centers", "half_sizes"))
    return np.stack((centres - halves, centres + halves), axis=1)


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    """Two frames of a level road with exact depth; the camera is 1.4 m above it."""
    return replayed(tmp_path_factory.mktemp("road"), logs.items(frames=2))


def replayed(folder, items):
    source = logs.write(folder / "in.mcap", items)
    assert replay_main([str(source), str(folder / "out.mcap"), "--quiet"]) == 0
    save_recording(folder / "out.mcap", folder / "out.rrd", {})
    return recorded(folder / "out.rrd")


def test_depth_points_are_on_the_road(road):
    camera, ego_T_camera = front(road)
    cells = shown(road, "/camera/front/depth", 0)
    depth_m = np.frombuffer(bytes(cells["DepthImage:buffer"][0]), np.uint16).reshape(camera.size) / 1000.0
    rows, columns = np.nonzero((depth_m > 0) & (depth_m < 20))
    seen = rays(camera, np.stack((columns, rows), axis=-1) + 0.5) * depth_m[rows, columns, None]
    z_m = transform(ego_T_camera, seen)[:, 2]
    mesh = np.array(shown(road, "/perception/surface", 0)["Mesh3D:vertex_positions"])
    assert len(z_m) > 10_000
    assert abs(mesh[:, 2]).max() < 0.005
    assert abs(z_m).max() < 0.002


def test_the_occupancy_map_is_slightly_below_the_road(road):
    (x_m, y_m, z_m) = shown(road, "/perception/occupancy", 0)["GridMap:translation"][0]
    mesh = np.array(shown(road, "/perception/surface", 0)["Mesh3D:vertex_positions"])
    assert -0.1 < z_m - mesh[:, 2].min() < -0.02
    occupancy = load_config().occupancy
    assert (x_m, y_m) == pytest.approx((occupancy.x_min_m, -occupancy.half_width_m), abs=1e-6)


def test_results_of_left_frames_belong_to_the_left_camera(tmp_path):
    stereo = {"image": "left", "calibration": "left_calibration"}
    items = [replace(i, role=stereo.get(i.role, i.role)) for i in logs.items(frames=2) if i.role != "tf"]
    entities = replayed(tmp_path, items)
    wanted = mounting(z=load_config().surface.assumed_height_m)
    assert ego_T(entities, "camera", 0) == pytest.approx(wanted, abs=1e-5)
    lanes = shown(entities, "/perception/lanes/annotations/smoothed", 0)
    assert lanes["CoordinateFrame:frame"] == ["camera_image_plane"]


def test_each_frame_has_one_entity_if_cameras_share_theirs(tmp_path):
    """As in the bags of RealSense and ZED: colour, depth and left camera in one frame, transforms on two topics."""
    items = logs.items(frames=2)
    calibration, edge = (next(item for item in items if item.role == role) for role in ("calibration", "tf"))
    items += [replace(calibration, role=f"{role}_calibration") for role in ("depth", "left")]
    items += [replace(item, role="left") for item in items if item.role == "image"]
    items += [replace(edge, role="tf_static")]
    entities = replayed(tmp_path, sorted(items, key=lambda item: item.stamp_ns))
    placed = Counter()
    for entity in entities:
        cells = shown(entities, entity, 1)
        placed.update(name for key in ("Transform3D", "Pinhole") for name in cells.get(f"{key}:child_frame", ()))
    assert placed["camera_image_plane"] == 1
    assert set(placed.values()) == {1}


@pytest.mark.parametrize("role", ["tf", "tf_static"])
def test_a_mounting_in_two_edges_equals_one_edge(tmp_path, road, role):
    """The same mounting as two edges, the upper one last, and a car that moves in a map."""
    up = rigid(np.eye(3), np.array([0.0, 0.0, 0.3]))
    edges = (
        Transform("base_link", "camera", inverse(up) @ logs.SMALL.ego_T_camera),
        Transform("base_footprint", "base_link", up),
    )
    made = [logs.Item(role, logs.START_NS, encode_transforms(logs.START_NS, [edge])) for edge in edges]
    moved = Transform("map", "base_footprint", rigid(np.eye(3), np.array([50.0, 0.0, 0.0])))
    made += [logs.Item("tf", logs.START_NS, encode_transforms(logs.START_NS, [moved]))]
    items = [item for item in logs.items(frames=2) if item.role != "tf"]
    entities = replayed(tmp_path, [*made, *items])
    assert front(entities)[1] == pytest.approx(logs.SMALL.ego_T_camera, abs=1e-6)
    assert ego_T(entities, "map", 1)[:3, 3] == pytest.approx([-50.0, 0.0, 0.0])
    for name in ("camera_height_m", "lane_left_offset_m"):
        values = [
            [cell[0] for cell in e[f"/perception/metrics/{name}"].column("Scalars:scalars")] for e in (road, entities)
        ]
        assert values[1] == pytest.approx(values[0], abs=1e-6)
