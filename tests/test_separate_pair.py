"""Replays of a log with a separate stereo pair that gives the only depth."""

from dataclasses import replace

import cv2
import numpy as np
import polars as pl
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from roadperc_stream import geometry as g
from roadperc_stream import log
from roadperc_stream.config import load_config
from roadperc_stream.formats import images
from roadperc_stream.input.decoding.ros import unpack_image
from roadperc_stream.metrics.surface import intersection_over_union
from roadperc_stream.model import Transform
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE
from roadperc_stream.output import encoding
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.roadperc_pb2 import Surface
from tests import logs, pair
from tests.analytic import LINE, ROAD, STEP_NS, VEHICLE, Road, box
from tests.replaying import replay

FRAMES = 3
FRONT = Road(height_m=1.4, pitch=0.02, width=480, height=360)
PINHOLE = g.Camera("left", 640, 480, 320.0, 320.0, 319.5, 239.5)
LEFT_HEIGHT_M = 1.2
EGO_T_PAIR = g.rigid(g.EGO_R_OPTICAL, np.array([0.1, 0.3, LEFT_HEIGHT_M]))
"""0.3 m to the left of the front camera, 0.2 m lower."""


def rectified():
    ego_T_right = EGO_T_PAIR @ g.rigid(np.eye(3), np.array([0.5, 0.0, 0.0]))
    return (PINHOLE, EGO_T_PAIR), (replace(PINHOLE, frame_id="right", baseline_m=0.5), ego_T_right)


def front_view():
    """(H, W) tags, ego points and the car's pixels in the front camera."""
    _, points, car = pair.scene(pair.directions(FRONT.camera), FRONT.ego_T_camera)
    tags = FRONT.tags()
    tags[car] = VEHICLE
    return tags, points, car


def held_items(cameras):
    edges = [Transform("ego", "camera", FRONT.ego_T_camera)]
    edges += [Transform("ego", camera.frame_id, ego_T_camera) for camera, ego_T_camera in cameras]
    roles = [("calibration", FRONT.camera), *((f"{camera.frame_id}_calibration", camera) for camera, _ in cameras)]
    calibrations = [logs.Item(role, logs.START_NS, encoding.encode_calibration(logs.START_NS, c)) for role, c in roles]
    return [*calibrations, logs.Item("tf", logs.START_NS, encoding.encode_transforms(logs.START_NS, edges))]


def items(cameras, without=()):
    """Messages of a car that stands still; ``without`` has pairs of frame and role that are missing."""
    tags, _, car = front_view()
    rows, columns = np.nonzero(car)
    seen = [box("Car", columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)]
    views = {"image": ("camera", pair.photograph(FRONT.camera, FRONT.ego_T_camera))}
    views |= {camera.frame_id: (camera.frame_id, pair.photograph(camera, mounting)) for camera, mounting in cameras}
    made = held_items(cameras)
    for k in range(FRAMES):
        stamp = logs.START_NS + k * STEP_NS
        messages = {
            role: encoding.encode_image(stamp, frame_id, "png", cv2.imencode(".png", pixels)[1].tobytes())
            for role, (frame_id, pixels) in views.items()
        }
        messages["segmentation"] = encoding.encode_image(
            stamp, "camera", "png", images.encode_indices(tags, TABLE.colours)
        )
        messages["detections"] = encoding.encode_detections(stamp, "camera", seen)
        made += [logs.Item(role, stamp, data) for role, data in messages.items() if (k, role) not in without]
    return made


def replayed(folder, messages):
    """The metrics' table, and the last message of each result topic."""
    target = folder / "out.mcap"
    replay(logs.write(folder / "in.mcap", messages), target, load_config())
    last = {message.channel.topic: message.data for message in log.read(log.summarise(target))}
    return pl.read_parquet(sidecar_path(target, "metrics")), last


@pytest.fixture(
    scope="module",
    params=[rectified(), pair.crooked(PINHOLE, 0.5, EGO_T_PAIR, 2.0)],
    ids=["rectified", "crooked"],
)
def run(request, tmp_path_factory):
    """The left camera and its mounting, the table, and the last results."""
    return *request.param[0], *replayed(tmp_path_factory.mktemp("pair"), items(request.param))


def test_the_surface_is_in_the_left_camera(run):
    _, ego_T_left, table, last = run
    assert table["reasons"].to_list() == [[]] * FRAMES
    assert set(table["surface_source"]) == {"stereo"}
    assert table["camera_height_m"].to_list() == pytest.approx([LEFT_HEIGHT_M] * FRAMES, abs=0.01)
    surface = Surface.FromString(last["/perception/surface"])
    assert surface.frame_id == "left"
    normal = np.array([surface.normal.x, surface.normal.y, surface.normal.z])
    assert np.degrees(g.angle_between(normal, ego_T_left[2, :3])) < 0.05


def test_the_depth_is_in_the_left_camera(run):
    left, ego_T_left, _, last = run
    message = unpack_image(last["/perception/stereo/depth"])
    assert (message.frame_id, message.encoding) == ("left", "16UC1")
    true_m = pair.depth_of(left, ego_T_left)
    depth_m = images.depth_from_mm(message.pixels)[true_m < 25]
    error = np.abs(depth_m / true_m[true_m < 25] - 1)
    assert np.isfinite(error).mean() > 0.88
    assert np.nanmedian(error) < 0.005


def test_mask_lanes_and_distances_are_in_the_front_camera(run):
    *_, table, last = run
    mask = images.decode_indices(CompressedImage.FromString(last["/perception/drivable"]).data) > 0
    tags, points, _ = front_view()
    assert mask.shape == FRONT.camera.size
    assert not mask[~np.isin(tags, (LINE, ROAD))].any()
    near = points[..., 0] < 30
    assert intersection_over_union(mask & near, np.isin(tags, (LINE, ROAD)) & near) > 0.85
    assert table["lane_left_offset_m"].to_list() == pytest.approx([FRONT.left_m] * FRAMES, abs=0.02)
    assert table["lane_right_offset_m"].to_list() == pytest.approx([FRONT.right_m] * FRAMES, abs=0.02)
    # The 2 % quantile of distances of 12 m that are known to 0.1 px of 13.4 lies some 2 % nearer.
    assert table["nearest_object_m"].to_list() == pytest.approx([pair.CAR_X_M] * FRAMES, rel=0.025)


def test_a_missing_left_image_is_not_replaced_by_the_front_image(tmp_path):
    table, _ = replayed(tmp_path, items(rectified(), without=[(1, "left")]))
    assert table["missing"].to_list() == [[], ["left"], []]
    assert table["stereo_valid_ratio"].is_null().to_list() == [False, True, False]
    assert "stereo.no_left_image" in table["reason_codes"].to_list()[1]
    assert table["surface_source"].to_list() == ["stereo", "held", "stereo"]


def paired(left_frame_id, edges, **changes):
    """A pair of the front camera and the right one, with a calibration of the left camera but no image of it."""
    front, ego_T_front = replace(PINHOLE, frame_id="camera"), EGO_T_PAIR
    right, left = replace(PINHOLE, frame_id="right", baseline_m=0.5), replace(PINHOLE, frame_id=left_frame_id)
    roles = {"calibration": front, "left_calibration": replace(left, **changes), "right_calibration": right}
    made = [logs.Item(role, logs.START_NS, encoding.encode_calibration(logs.START_NS, c)) for role, c in roles.items()]
    edges = [Transform("ego", "camera", ego_T_front), *edges]
    made.append(logs.Item("tf", logs.START_NS, encoding.encode_transforms(logs.START_NS, edges)))
    aside = ego_T_front @ g.rigid(np.eye(3), np.array([0.5, 0.0, 0.0]))
    for role, camera, ego_T_camera in (("image", front, ego_T_front), ("right", right, aside)):
        png = cv2.imencode(".png", pair.photograph(camera, ego_T_camera))[1].tobytes()
        made.append(logs.Item(role, logs.START_NS, encoding.encode_image(logs.START_NS, camera.frame_id, "png", png)))
    return made


HERE, ASIDE = (Transform("camera", "left", g.rigid(np.eye(3), np.array([x, 0.0, 0.0]))) for x in (0.0, 0.2))


@pytest.mark.parametrize(("frame_id", "edges"), [("camera", []), ("", []), ("left", [HERE])])
def test_a_left_calibration_may_describe_the_front_camera(tmp_path, frame_id, edges):
    table, _ = replayed(tmp_path, paired(frame_id, edges))
    assert table["stereo_valid_ratio"].to_list()[0] > 0.3
    assert table["camera_height_m"].to_list() == pytest.approx([LEFT_HEIGHT_M], abs=0.01)


@pytest.mark.parametrize(
    ("frame_id", "edges", "changes"),
    [("left", [ASIDE], {}), ("left", [], {}), ("camera", [], {"fx": 300.0}), ("left", [HERE], {"width": 600})],
)
def test_a_left_calibration_of_another_camera_needs_its_image(tmp_path, frame_id, edges, changes):
    table, _ = replayed(tmp_path, paired(frame_id, edges, **changes))
    assert "stereo.no_left_image" in table["reason_codes"].to_list()[0]


def test_messages_beyond_2038_are_left_out_with_a_reason(tmp_path, monkeypatch):
    at_2020, before = replayed(tmp_path, items(rectified()))
    monkeypatch.setattr(logs, "START_NS", 2**31 * 10**9)
    (tmp_path / "late").mkdir()
    table, last = replayed(tmp_path / "late", items(rectified()))
    left_out = {"/perception/stereo/depth", "/perception/occupancy"}
    assert left_out <= set(before)
    assert set(before) - set(last) == left_out
    assert table["stereo_valid_ratio"].to_list() == at_2020["stereo_valid_ratio"].to_list()
    for reasons in table["reasons"].to_list():
        assert [(r["source"], r["code"]) for r in reasons] == [("stereo", "not_written"), ("occupancy", "not_written")]
        assert reasons[0]["values"] == ["2147483647999999999"]
