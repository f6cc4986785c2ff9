"""What the car's own motion does to an object's distance: of what stands still it is all there is.

It is known from odometry, so that the filter of a distance need not learn that the car brakes, turns, or passes
beside: a known input (Bar-Shalom, Li and Kirubarajan 2001, section 5.2.1).
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from roadperc_stream.core.geometry import Float, inverse, transform
from roadperc_stream.core.scene import Scene

Ray = tuple[float, float, float]
"""A direction in the camera's frame."""


@dataclass(frozen=True)
class EgoRate:
    """How fast the car's own motion changes a distance, m/s: in the mean over the last ``dt_s``, and at their end."""

    mean_mps: float
    end_mps: float
    dt_s: float

    @classmethod
    def after(cls, change_m: float, dt_s: float, before: "EgoRate | None") -> "EgoRate":
        """By the distance's change over a step; its change of pace goes on to the step's end."""
        mean_mps = change_m / dt_s
        if before is None:
            return cls(mean_mps, mean_mps, dt_s)
        return cls(mean_mps, mean_mps + (mean_mps - before.mean_mps) * dt_s / (dt_s + before.dt_s), dt_s)


def motion_of_camera(scene: Scene, last_T_this: Float | None) -> Float | None:
    """(4, 4) the transform of the camera's coordinates at the last frame to those now; None where it is not known."""
    return None if last_T_this is None else inverse(last_T_this @ scene.ego_T_camera) @ scene.ego_T_camera


def change_of_distance_m(now_T_last: Float, ray: Ray, distance_m: float) -> float:
    """By how much the distance of what stands still in that direction has changed."""
    direction = np.array(ray)
    return _length(transform(now_T_last, direction * (distance_m / _length(direction)))) - distance_m


def _length(vector: Float) -> float:
    """What NumPy's own norm is, and takes five times as long for."""
    return sqrt(float(vector.dot(vector)))
