"""Annotations and 3D drawings are at the places of the results."""

from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from roadperc_stream.geometry import inverse, project, transform
from roadperc_stream.geometry.rotations import rotation_from_quaternion
from roadperc_stream.model import Boundary, Box, Detection, Lanes, Object, Objects
from roadperc_stream.output.drawing.annotations import (
    drivable_scene,
    lane_annotations,
    object_annotations,
    objects_scene,
)
from tests.hills import Hill

HILL = Hill(width=320, height=240)


def scene(surface):
    mask = HILL.depth_m() < 25
    (entity,) = SceneUpdate.FromString(drivable_scene(1, surface, HILL.camera, HILL.ego_T_camera, mask)).entities
    patch, outline = (
        np.array([(p.x, p.y, p.z) for p in shape.points]) for shape in (entity.triangles[0], entity.lines[0])
    )
    return patch, np.array(entity.triangles[0].indices).reshape(-1, 3), outline


@pytest.mark.parametrize("model", ["plane", "spline"])
def test_patch_and_outline_are_on_the_road(model):
    surface = HILL.surface()
    surface = surface if model == "spline" else replace(surface, model=model, height_grid=None)
    patch, triangles, outline = scene(surface)
    assert len(triangles) == len(patch) - 2
    assert set(triangles.ravel()) == set(range(len(patch)))
    for points in (patch, outline):
        expected = HILL.z(points[:, 0], points[:, 1]) if model == "spline" else 0.0
        np.testing.assert_allclose(points[:, 2], expected, atol=0.01)
    sides = patch[triangles]
    area = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])[:, 2] / 2
    assert np.abs(area).sum() == pytest.approx(38 * 8)


def objects_entity(*items):
    message = SceneUpdate.FromString(objects_scene(7, HILL.camera, HILL.ego_T_camera, Objects(items)))
    (entity,) = message.entities
    return entity


def test_a_kept_object_covers_its_box_at_its_distance():
    box = Box(200, 100, 260, 140)
    entity = objects_entity(Object(Detection("Car", box, 0.9), kept=True, distance_m=12.0, time_to_impact_s=1.5))
    (cube,), (text,) = entity.cubes, entity.texts
    place, turned = cube.pose.position, cube.pose.orientation
    half = np.array([cube.size.x, cube.size.y]) / 2
    corners = np.array([(-half[0], -half[1], 0), (half[0], half[1], 0)])
    rotation = rotation_from_quaternion(turned.x, turned.y, turned.z, turned.w)
    centre = np.array([place.x, place.y, place.z])
    seen = project(HILL.camera, transform(inverse(HILL.ego_T_camera), corners @ rotation.T + centre))
    np.testing.assert_allclose(seen, [(199.5, 99.5), (259.5, 139.5)], atol=1e-6)
    assert np.linalg.norm(centre - HILL.ego_T_camera[:3, 3]) == pytest.approx(12.0)
    assert text.text == "Car 12.0 m 1.5 s"
    assert text.pose.position.z > place.z


def test_objects_dropped_or_without_distance_give_an_empty_entity():
    """It replaces the entity of the previous frame, which viewers would keep."""
    detection = Detection("Car", Box(10, 10, 20, 20), 0.9)
    entity = objects_entity(Object(detection, kept=False, distance_m=5.0), Object(detection, kept=True))
    assert (entity.id, entity.frame_id, len(entity.cubes), len(entity.texts)) == ("objects", "ego", 0, 0)


def captions(*items):
    message = ImageAnnotations.FromString(object_annotations(7, HILL.camera, Objects(items)))
    return [(text.text, text.position.x, text.font_size) for text in message.texts]


def test_a_caption_is_inside_the_image():
    detection = Detection("Pedestrian", Box(300, 100, 318, 140), 0.9)
    ((text, x, font_px),) = captions(Object(detection, kept=False, class_ratio=0.25))
    assert text == "Pedestrian 25%"
    assert 0 < x <= HILL.camera.width - 0.6 * font_px * len(text)


CROWD = tuple(
    Object(Detection("Car", Box(10, 100, 40, 140), 0.9), kept=True, distance_m=distance_m)
    for distance_m in (30.0, 4.0, 12.0, 20.0)
)
"""Four objects at one place, which has space for three captions: above, inside and below the box."""


def test_the_nearest_objects_get_captions_without_overlap():
    message = ImageAnnotations.FromString(object_annotations(7, HILL.camera, Objects(CROWD)))
    assert [text.text for text in message.texts] == ["Car 20.0 m", "Car 12.0 m", "Car 4.0 m"]
    assert len(message.points) == 4
    bottoms = sorted(text.position.y for text in message.texts)
    assert np.diff(bottoms).min() > message.texts[0].font_size


def test_objects_without_a_caption_in_the_image_have_none_in_3d():
    entity = objects_entity(*CROWD)
    assert len(entity.cubes) == 4
    assert [text.text for text in entity.texts] == ["Car 4.0 m", "Car 12.0 m", "Car 20.0 m"]


def test_proposals_are_fainter_than_boundaries():
    line = (10.0, 200.0, 60.0, 120.0)
    ends = np.array(line).reshape(2, 2)
    lanes = Lanes(
        (Boundary("left", "measured", raw_px=line, line_px=ends, offset_m=1.5),), proposals_px=np.array([line])
    )
    proposed, raw, smoothed = ImageAnnotations.FromString(lane_annotations(7, HILL.camera, lanes)).points
    assert proposed.outline_color.a < raw.outline_color.a == smoothed.outline_color.a == 1.0
    assert proposed.thickness < raw.thickness < smoothed.thickness
