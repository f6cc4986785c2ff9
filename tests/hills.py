"""The images of a road over a known hill z(x, y), found by following the rays of a pinhole camera."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from roadperc_stream import geometry as g
from roadperc_stream.model import HeightGrid, Surface
from tests.analytic import Road

DEPTHS_M = np.geomspace(0.5, 150.0, 90)


@dataclass(frozen=True)
class Hill(Road):
    """A road that is level at x = 0, then a wave of length ``wave_m`` and steepest ``grade``; ``bank`` tilts it."""

    grade: float = 0.08
    wave_m: float = 240.0
    bank: float = 0.0

    def z(self, x, y):
        turn = 2 * np.pi / self.wave_m
        return self.grade / turn * (1 - np.cos(turn * x)) + self.bank * y

    def ground(self):
        return _ground(self)

    def follow_rays(self):
        rows, columns = np.indices((self.height, self.width), dtype=float)
        rays = g.rays(self.camera, np.stack((columns, rows), axis=-1))
        depth = np.full(rows.shape, np.nan)
        for row in range(self.height):  # a row at a time, as all rays at once need gigabytes
            depth[row] = self._meets(rays[row] @ self.ego_T_camera[:3, :3].T)
        points = rays * depth[..., None]
        return points, g.transform(self.ego_T_camera, points)

    def _meets(self, directions):
        """The depth at which rays meet the road: the first sampled depth below it, refined by bisection."""
        below = self._gap(directions[:, None, :], DEPTHS_M) <= 0
        first = np.where(below.any(axis=1), below.argmax(axis=1), 1)
        low, high = DEPTHS_M[first - 1], DEPTHS_M[first]
        for _ in range(25):
            middle = (low + high) / 2
            under = self._gap(directions, middle) <= 0
            low, high = np.where(under, low, middle), np.where(under, middle, high)
        return np.where(below.any(axis=1), low, np.nan)

    def _gap(self, directions, depth):
        x, y, z = np.moveaxis(self.ego_T_camera[:3, 3] + directions * np.asarray(depth)[..., None], -1, 0)
        return z - self.z(x, y)

    def height_grid(self):
        x, y = np.meshgrid(np.arange(61.0), np.arange(-8.0, 9.0))
        return HeightGrid(0.0, -8.0, 1.0, self.z(x, y).astype(np.float32))

    def surface(self):
        """The true surface; its plane is the road's at the car."""
        ego_plane = g.Plane.of(np.array([0.0, -self.bank, 1.0]), 0.0)
        plane = g.transform_plane(g.inverse(self.ego_T_camera), ego_plane)
        pitch, roll = g.camera_pitch_roll(plane)
        return Surface(
            "truth", "camera", plane, ego_plane, plane.offset_m, pitch, roll, None, "spline", self.height_grid()
        )


@lru_cache(maxsize=4)
def _ground(hill):
    return hill.follow_rays()
