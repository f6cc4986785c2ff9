"""The place of an object on the ground and its speed over the ground, by which detections and tracks are associated.

Place and speed are in the axes of the camera. The camera's motion by odometry moves the place to the next frame, so a
standing object stays where it is however fast the car drives. A new object may have any usual speed of its kind.
"""

from dataclasses import dataclass
from math import hypot
from typing import Final

from roadperc_stream.chain.stages.objects import rate_filter
from roadperc_stream.chain.stages.objects.rate_filter import RateFilter, Rows, moved
from roadperc_stream.geometry import Camera
from roadperc_stream.model import Box
from roadperc_stream.model.tag_tables import classes_of_label

_SPEED_STD_MPS: Final = 15.0
_WALKING_STD_MPS: Final = 2.0
"""Standard deviation of the unknown speed of an object over the ground, and of a pedestrian's."""
_SPEED_WALK: Final = 3.0
"""Standard deviation of the change of that speed within a second, m/s."""
_WIDTH_STD: Final = 0.15
"""Standard deviation of the middle of an object, in its widths: other parts of it become visible."""
_LEAST_STD_M: Final = 0.15
_DISTANCE_STD: Final = 0.05
"""Standard deviation of a distance, as a share: distances of stereo jump by more than their own deviation."""


@dataclass(frozen=True)
class Sighting:
    """Where an object is seen: (x, y, z) of its middle in the camera's frame, and the deviations of x and z, metres."""

    point_m: tuple[float, float, float]
    right_std_m: float
    ahead_std_m: float


@dataclass(frozen=True)
class GroundPlace:
    """Filters of the place and the speed over the ground, to the right of the camera and ahead, metres."""

    right_m: RateFilter
    ahead_m: RateFilter
    down_m: float

    @classmethod
    def of_first(cls, seen: Sighting, label: str) -> "GroundPlace":
        """The place of a new object with a label."""
        speed_std_mps = usual_speed_std_mps(label)
        right_m = rate_filter.start(seen.point_m[0], seen.right_std_m, speed_std_mps)
        return cls(right_m, rate_filter.start(seen.point_m[2], seen.ahead_std_m, speed_std_mps), seen.point_m[1])

    def predict(self, now_T_last: Rows, dt_s: float) -> "GroundPlace":
        """The place ``dt_s`` seconds later, in the axes of the camera after its (4, 4) motion."""
        right_m, ahead_m = self.right_m.predict(_SPEED_WALK, dt_s), self.ahead_m.predict(_SPEED_WALK, dt_s)
        x, y, z = moved(now_T_last, (right_m.value, self.down_m, ahead_m.value))
        x_mps, _, z_mps = moved(now_T_last, (right_m.rate, 0.0, ahead_m.rate), shift=0.0)
        right_m = right_m.shifted(x - right_m.value, x_mps - right_m.rate)
        return GroundPlace(right_m, ahead_m.shifted(z - ahead_m.value, z_mps - ahead_m.rate), y)

    @property
    def receding_mps(self) -> float:
        """The speed over the ground away from the camera, m/s."""
        right_m, ahead_m = self.right_m, self.ahead_m
        range_m = max(hypot(right_m.value, ahead_m.value), _LEAST_STD_M)
        return (right_m.value * right_m.rate + ahead_m.value * ahead_m.rate) / range_m

    def update(self, seen: Sighting) -> "GroundPlace":
        """The predicted place after the object was seen."""
        x, y, z = seen.point_m
        return GroundPlace(self.right_m.update(x, seen.right_std_m), self.ahead_m.update(z, seen.ahead_std_m), y)


def sighting(camera: Camera, box_px: Box, distance_m: float, std_m: float) -> Sighting:
    """The sighting of an object by its box within the image, its distance and the distance's deviation, metres."""
    x = ((box_px.x_min + box_px.x_max) / 2 - 0.5 - camera.cx) / camera.fx
    y = ((box_px.y_min + box_px.y_max) / 2 - 0.5 - camera.cy) / camera.fy
    ahead_m = distance_m / hypot(x, y, 1.0)
    width_m = (box_px.x_max - box_px.x_min) / camera.fx * ahead_m
    aside_std_m = hypot(_WIDTH_STD * width_m, abs(x) * std_m, _LEAST_STD_M)
    return Sighting((x * ahead_m, y * ahead_m, ahead_m), aside_std_m, hypot(std_m, _DISTANCE_STD * distance_m))


def usual_speed_std_mps(label: str) -> float:
    """Standard deviation of the speed over the ground of objects with a label, m/s."""
    return _WALKING_STD_MPS if classes_of_label(label) == ("pedestrian",) else _SPEED_STD_MPS
