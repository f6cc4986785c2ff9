"""A rendered dump, read independently of the renderer."""

import json

import cv2
import numpy as np

from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14

CAMERA_X, CAMERA_Z = 1.5, 1.4
TAG = {name: tag for tag, name in enumerate(CARLA_FROM_0_9_14.names)}


class Dump:
    def __init__(self, folder):
        self.folder = folder
        self.calibration = self.json("calibration")
        self.truth = self.json("truth")
        self.names = list(self.json("poses"))

    def json(self, name):
        return json.loads((self.folder / f"{name}.json").read_text())

    def tags(self, name, room="segmentation"):
        return cv2.imread(str(self.folder / room / f"{name}.png"), cv2.IMREAD_UNCHANGED)[..., 2]

    def depth(self, name, room="depth"):
        b, g, r = np.moveaxis(cv2.imread(str(self.folder / room / f"{name}.png"))[..., :3].astype(float), 2, 0)
        return (r + 256 * g + 65536 * b) / (2**24 - 1) * 1000

    def rgb(self, name, room="rgb"):
        return cv2.imread(str(self.folder / room / f"{name}.png")).astype(float)

    @property
    def pinhole(self):
        """f, cx, cy with pixel centres at integers."""
        K = np.array(self.calibration["K"])
        return K[0, 0], K[0, 2] - 0.5, K[1, 2] - 0.5

    def pixels(self):
        return np.meshgrid(np.arange(self.calibration["width"]), np.arange(self.calibration["height"]))

    def ego_points(self, name):
        """(H, W, 3) x forward, y left, z up of every pixel, from the depth."""
        f, cx, cy = self.pinhole
        u, v = self.pixels()
        z = self.depth(name)
        return np.stack((z + CAMERA_X, -(u - cx) / f * z, CAMERA_Z - (v - cy) / f * z), axis=-1)

    def world_points(self, name):
        """The same in the right-handed world, by CARLA's own left-handed matrix (carla.Transform.get_matrix)."""
        pose = self.json("poses")[name]
        cp, cy, cr = (np.cos(np.radians(pose["rotation"][a])) for a in ("pitch", "yaw", "roll"))
        sp, sy, sr = (np.sin(np.radians(pose["rotation"][a])) for a in ("pitch", "yaw", "roll"))
        R = np.array(
            [
                [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr],
                [cp * sy, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr],
                [sp, -cp * sr, cp * cr],
            ]
        )
        left_handed = self.ego_points(name) * (1, -1, 1)
        world = left_handed @ R.T + [pose["location"][a] for a in "xyz"]
        return world * (1, -1, 1)
