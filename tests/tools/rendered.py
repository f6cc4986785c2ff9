"""Read a rendered dump independently of the renderer."""

import json
from functools import lru_cache

import cv2
import numpy as np

from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14

CAMERA_X, CAMERA_Z = 1.5, 1.4
TAG = {name: tag for tag, name in enumerate(CARLA_FROM_0_9_14.names)}


def carla_rotation(roll, pitch, yaw):
    """Return (3, 3) of angles in degrees, as GetMatrix in carla/geom/Transform.h."""
    (cr, cp, cy), (sr, sp, sy) = (wave(np.radians([roll, pitch, yaw])) for wave in (np.cos, np.sin))
    return np.array(
        [
            [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr],
            [cp * sy, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr],
            [sp, -cp * sr, cp * cr],
        ]
    )


@lru_cache(maxsize=8)
def picture(path):
    return cv2.imread(str(path))


class Dump:
    def __init__(self, folder):
        self.folder = folder
        self.calibration = self.json("calibration")
        self.truth = self.json("truth")
        self.names = list(self.json("poses"))

    def json(self, name):
        return json.loads((self.folder / f"{name}.json").read_text())

    def tags(self, name, folder="segmentation"):
        return picture(self.folder / folder / f"{name}.png")[..., 2]

    def depth(self, name, folder="depth"):
        b, g, r = np.moveaxis(picture(self.folder / folder / f"{name}.png").astype(float), 2, 0)
        return (r + 256 * g + 65536 * b) / (2**24 - 1) * 1000

    def rgb(self, name, folder="rgb"):
        return picture(self.folder / folder / f"{name}.png").astype(float)

    @property
    def pinhole(self):
        """f, cx, cy with pixel centres at integers."""
        K = np.array(self.calibration["K"])
        return K[0, 0], K[0, 2] - 0.5, K[1, 2] - 0.5

    def pixels(self):
        return np.meshgrid(np.arange(self.calibration["width"]), np.arange(self.calibration["height"]))

    def ego_points(self, name):
        """Return (H, W, 3) x forward, y left, z up of every pixel, from the depth."""
        f, cx, cy = self.pinhole
        u, v = self.pixels()
        z = self.depth(name)
        return np.stack((z + CAMERA_X, -(u - cx) / f * z, CAMERA_Z - (v - cy) / f * z), axis=-1)

    def world_points(self, name):
        """Return the points in the right-handed world, by CARLA's left-handed matrix."""
        pose = self.json("poses")[name]
        left_handed = self.ego_points(name) * (1, -1, 1)
        world = left_handed @ carla_rotation(**pose["rotation"]).T + [pose["location"][a] for a in "xyz"]
        return world * (1, -1, 1)

    def tag_at(self, name, point, aside_m):
        """Return the tag ``aside_m`` to the left of a point in the ego frame; None if hidden or out of view."""
        f, cx, cy = self.pinhole
        x, y, z = point[0] - CAMERA_X, point[1] + aside_m, point[2] - CAMERA_Z
        u, v = round(cx - f * y / x), round(cy - f * z / x)
        inside = 0 <= u < self.calibration["width"] and 0 <= v < self.calibration["height"]
        seen = inside and abs(self.depth(name)[v, u] - x) < 0.05 * x
        return self.tags(name)[v, u] if seen else None
