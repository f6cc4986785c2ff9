"""A road that can be computed by hand: what a pinhole camera sees of a plane with two lane lines."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from roadperc_stream import geometry as g
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.model import Box, DepthImage, Detection, Frame, TagImage
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE

OTHER, PEDESTRIAN, LINE, ROAD, SIDEWALK, VEHICLE = 0, 4, 6, 7, 8, 10
STEP_NS = 50_000_000


@dataclass(frozen=True)
class Road:
    """Boundaries in the ego frame: the inner edges of a line on the left and of a sidewalk on the right."""

    left_m: float = 1.8
    right_m: float = -1.9
    heading: float = 0.0
    curvature_per_m: float = 0.0
    height_m: float = 1.4
    pitch: float = 0.0
    roll: float = 0.0
    line_m: float = 0.15
    width: int = 640
    height: int = 480

    @property
    def camera(self):
        return g.Camera("camera", self.width, self.height, self.width / 2, self.width / 2, *self.centre)

    @property
    def centre(self):
        return (self.width - 1) / 2, (self.height - 1) / 2

    @property
    def ego_T_camera(self):
        rotation = rotation_from_rpy(self.roll, self.pitch, 0.0) @ g.EGO_R_OPTICAL
        return g.rigid(rotation, np.array([0.0, 0.0, self.height_m]))

    @property
    def plane(self):
        return g.transform_plane(g.inverse(self.ego_T_camera), g.Plane.of(np.array([0.0, 0.0, 1.0]), 0.0))

    def lateral(self, offset_m, x):
        return offset_m + self.heading * x + 0.5 * self.curvature_per_m * x**2

    def ground(self):
        """(H, W, 3) camera points and (H, W, 3) ego points on the road, NaN above the horizon."""
        return _ground(replace(self, left_m=0.0, right_m=0.0, heading=0.0, curvature_per_m=0.0, line_m=0.0))

    def depth_m(self):
        depth = self.ground()[0][..., 2].astype(np.float32)
        depth[~(depth < 500)] = np.nan
        return depth

    def tags(self):
        x, y, _ = np.moveaxis(self.ground()[1], -1, 0)
        left = y - self.lateral(self.left_m, x)
        right = y - self.lateral(self.right_m, x)
        tags = np.full((self.height, self.width), OTHER, np.uint8)
        tags[(left < 4) & (right > -3)] = SIDEWALK
        tags[(left < 3.5) & (right > 0)] = ROAD
        tags[(left > 0) & (left < self.line_m)] = LINE
        tags[~(x < 150)] = OTHER
        return tags

    def frame(self, index=0, **changes):
        tags, depth = self.tags(), self.depth_m()
        frame = Frame.of(
            1_000_000_000 + index * STEP_NS,
            self.camera,
            self.ego_T_camera,
            mounted=True,
            depth_image=DepthImage("camera", lambda: (depth, 65.535)),
            segmentation=TagImage("camera", TABLE, lambda: tags),
            detections=(),
        )
        return replace(frame, **changes)


@lru_cache(maxsize=8)
def _ground(road):
    rows, columns = np.indices((road.height, road.width), dtype=float)
    points = g.intersect_plane(road.camera, np.stack((columns, rows), axis=-1), road.plane)
    return points, g.transform(road.ego_T_camera, points)


def box(label, x_min, y_min, x_max, y_max, score=0.9):
    return Detection(label, Box(x_min, y_min, x_max, y_max), score)
