"""The car's path: places beside circles known by construction, and what it is taken from."""

import numpy as np
import pytest

from roadperc_stream.chain.kernels import left_of
from roadperc_stream.chain.stages.objects.path import PATH_MEMORY_M, DrivenArc, EgoPath, path_of
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.model import Boundary, Lanes

CFG = ObjectsConfig()
RIGHT_BEND = DrivenArc(-0.1, 10.0)


def lanes(left_m, right_m, heading=0.0, curvature=0.0, changes=2):
    """Boundaries at these offsets; None is lost."""
    offsets = {"left": left_m, "right": right_m}
    return Lanes(
        tuple(
            Boundary(side, "lost")
            if offset is None
            else Boundary(side, "measured", offset_m=offset, heading=heading, curvature_per_m=curvature)
            for side, offset in offsets.items()
        ),
        lane_changes=changes,
    )


def step_of(metres, turn):
    """A step along a circle: last_T_this."""
    chord = metres if turn == 0 else 2 * metres / turn * np.sin(turn / 2)
    return rigid(rotation_from_rpy(0, 0, turn), np.array([chord * np.cos(turn / 2), chord * np.sin(turn / 2), 0]))


@pytest.mark.parametrize("radius_m", [12.0, -150.0, 1e9])
@pytest.mark.parametrize(("offset_m", "heading"), [(0.0, 0.0), (-0.7, 0.1)])
def test_places_beside_a_circle_are_square_to_it(radius_m, offset_m, heading):
    path = EgoPath("odometry", offset_m, heading, 1 / radius_m)
    along, aside = np.array([0.0, 5.0, 15.0]), np.array([0.4, -1.2, 3.0])
    turned = heading + along / radius_m
    middle = np.stack((np.sin(turned) - np.sin(heading), np.cos(heading) - np.cos(turned)), axis=-1) * radius_m
    points = middle + [0, offset_m] + aside[:, None] * np.stack((-np.sin(turned), np.cos(turned)), axis=-1)
    for (x, y), expected in zip(points, aside, strict=True):
        lateral = left_of(np.array([[x, y, 0.0]]), np.eye(4), path.circle)
        assert lateral == pytest.approx([expected], abs=1e-5)


def test_the_path_is_the_middle_of_the_lane():
    path = path_of(lanes(2.0, -1.5, heading=0.02, curvature=0.01), RIGHT_BEND)
    assert path == EgoPath("lane", 0.25, 0.02, 0.01, 1.75, 2)


@pytest.mark.parametrize("sides", [(2.0, None), (None, -1.0), (5.0, -1.5)])
def test_along_a_boundary_where_the_lane_is_not_known_or_too_wide(sides):
    assert path_of(lanes(*sides, heading=0.02), RIGHT_BEND) == EgoPath("boundary", 0.0, 0.02, 0.0, None, 2)


@pytest.mark.parametrize("ego_lane", [None, lanes(None, None), lanes(-1.8, -1.35)])
def test_the_circle_that_the_car_drives_on_where_no_lane_can_be_one(ego_lane):
    path = path_of(ego_lane, RIGHT_BEND)
    assert (path.source, path.curvature_per_m) == ("odometry", -0.01)
    assert path_of(ego_lane, DrivenArc()).source == "straight"


@pytest.mark.parametrize("steps", [40, 4])
def test_the_curvature_driven_does_not_depend_on_the_frame_rate(steps):
    arc = DrivenArc()
    for _ in range(steps):
        arc = arc.after(step_of(20 / steps, 0.4 / steps))
    assert arc.curvature_per_m == pytest.approx(0.02, rel=0.01)
    straight = arc
    for _ in range(steps):
        straight = straight.after(step_of(5 / steps, 0.0))
    assert straight.curvature_per_m == pytest.approx(0.02 * np.exp(-5 / PATH_MEMORY_M), rel=0.35)


def test_a_car_that_stands_still_keeps_its_curvature():
    arc = DrivenArc().after(step_of(1.0, 0.05))
    assert arc.after(step_of(0.0, 0.001)) == arc.after(None) == arc
    assert DrivenArc().after(step_of(0.05, 0.0)).curvature_per_m is None
