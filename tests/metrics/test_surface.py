"""The road's plane, heights and drivable pixels against truth, with answers worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream.geometry import Plane
from roadperc_stream.metrics import frame_metrics
from roadperc_stream.metrics.surface import intersection_over_union, surface_height_error_m
from roadperc_stream.model import DepthImage, HeightGrid, TagImage
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE
from tests.analytic import Road
from tests.hills import Hill
from tests.metrics.frames import CFG, sample_and_result


def test_intersection_over_union():
    a, b = np.zeros((2, 4), bool), np.zeros((2, 4), bool)
    a[0], b[0, 2:], b[1, :2] = True, True, True
    assert intersection_over_union(a, b) == pytest.approx(2 / 6)
    assert intersection_over_union(a, a) == 1.0
    assert intersection_over_union(a & False, b & False) is None


def test_a_fault_of_the_chains_mask_does_not_cancel(monkeypatch):
    """The chain takes everything within 10 m of the plane for the road; a block with the road's tag stands on it."""
    road = Road()
    tags, depth_m = road.tags(), road.depth_m().copy()
    drivable = TABLE.lookup(CFG.surface.classes)[tags] > 0
    block = np.zeros_like(drivable)
    block[320:350, 300:340] = drivable[320:350, 300:340]
    depth_m[block] *= np.float32(0.8)
    monkeypatch.setattr("roadperc_stream.chain.stages.surface.road._DRIVABLE_M", 10.0)
    _, result = sample_and_result()
    sample, _ = sample_and_result(
        surface=result.surface,
        depth=DepthImage("camera", lambda: (depth_m, 65.535)),
        segmentation=TagImage("camera", TABLE, lambda: tags),
    )
    row = frame_metrics(CFG, "id", sample, result)
    known = drivable & np.isfinite(depth_m)
    assert block.sum() > 500
    assert row.drivable_iou == pytest.approx((known & ~block).sum() / known.sum(), abs=0.01)


def test_a_surface_turned_by_a_degree():
    _, result = sample_and_result()
    turned = replace(
        result.surface, camera_height_m=1.5, ego_plane=Plane((np.sin(np.pi / 180), 0.0, np.cos(np.pi / 180)), 0.0)
    )
    level = replace(result.surface, camera_height_m=1.4, ego_plane=Plane((0.0, 0.0, 1.0), 0.0))
    sample, _ = sample_and_result(surface=turned)
    row = frame_metrics(CFG, "id", sample, replace(result, surface=level))
    assert row.surface_angle_error_deg == pytest.approx(1.0)
    assert row.camera_height_error_m == pytest.approx(-0.1)


def test_heights_are_judged_between_five_and_forty_metres():
    hill = Hill().surface()
    assert surface_height_error_m(hill, hill) == pytest.approx(0.0, abs=1e-6)
    z = hill.height_grid.z_m.copy()
    z[:, :5] += 9  # nearer than 5 m
    z[:, 41:] += 9  # farther than 40 m
    z[np.abs(np.arange(-8, 9)) >= 4] += 9
    z[5:12, 5:41] += 0.25
    raised = replace(hill, height_grid=HeightGrid(0.0, -8.0, 1.0, z))
    assert surface_height_error_m(raised, hill) == pytest.approx(0.25, abs=1e-6)


def test_heights_of_a_plane_and_without_truth():
    level = replace(Hill(grade=0.0).surface(), height_grid=None)
    raised = replace(level, ego_plane=Plane((0.0, 0.0, 1.0), -0.1))
    assert surface_height_error_m(raised, Hill(grade=0.0).surface()) == pytest.approx(0.1)
    assert surface_height_error_m(level, level) is None
    far = replace(level, height_grid=HeightGrid(50.0, 0.0, 1.0, np.zeros((2, 2), np.float32)))
    assert surface_height_error_m(level, far) is None
