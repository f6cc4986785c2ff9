"""Where things are beside the path that the ego car is going to take.

The path is a strip along the way that cars drive in the lane which the car's reference point is in, as wide as the
car and a margin on either side; where there is no lane it runs on as that of the first lane did.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.core.geometry import Float, inverse, transform

from .drawings import CAR_WIDTH_M
from .drive import SceneMoment, Thing

PATH_MARGIN_M: Final = 0.3


@dataclass(frozen=True)
class PathPlace:
    """How far a thing's middle is to the left of the path's, and whether any of it is in the path."""

    lateral_m: float
    in_path: bool


def path_place(moment: SceneMoment, thing: Thing) -> PathPlace:
    """Where a thing is beside the path."""
    world = moment.scenery.world
    corners = body_corners(thing, moment.time_s)
    road = world.path.around(moment.scenery.s_m)
    x, y = (np.append(corners[:, i], corners[:, i].mean()) - road.origin_m[i] for i in (0, 1))
    s, d = road.coordinates(x, y)
    lane = world.road.lanes.at(moment.scenery.s_m, moment.d_m) or world.road.lanes.start
    aside = d - [lane.way_m(float(at) + road.s_origin_m) for at in s]
    half = CAR_WIDTH_M / 2 + PATH_MARGIN_M
    return PathPlace(float(aside[-1]), bool(aside[:-1].min() < half and aside[:-1].max() > -half))


def body_corners(thing: Thing, time_s: float) -> Float:
    """(8, 3) the corners of the upright box around a thing in its own frame, in the world."""
    faces, pose = thing.faces, thing.pose(time_s)
    points = np.concatenate([faces.origin + a * faces.across + b * faces.up for a in (0, 1) for b in (0, 1)])
    body = transform(inverse(pose), points)
    low, high = body.min(axis=0), body.max(axis=0)
    corners = np.array([[(low, high)[(i >> axis) & 1][axis] for axis in range(3)] for i in range(8)])
    return transform(pose, corners)
