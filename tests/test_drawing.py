"""What is drawn of the road lies on the road."""

from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from roadperc_stream.drawing import drivable_scene
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
def test_patch_and_outline_lie_on_the_road(model):
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
