"""Artificial detections and distances: objects are boxes with constant depth."""

from dataclasses import dataclass, field, replace

import numpy as np

from roadperc_stream.chain.stages.objects.tracker import ObjectsState, step
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera
from roadperc_stream.model import Objects
from tests.analytic import STEP_NS, VEHICLE
from tests.scenes import scene_of

CAMERA = Camera("camera", 320, 240, 1e6, 1e6, 159.5, 119.5)
"""A lens so long that the distance of every pixel equals its depth."""
CFG = ObjectsConfig(distance_pixels="class")
"""All pixels of a box count: on this scale of millimetres, objects have no points above the ground."""
FAR_M = 90.0
LIMIT_M = 100.0


@dataclass
class Follower:
    """Runs the stage frame by frame and keeps the last objects."""

    cfg: ObjectsConfig = CFG
    state: ObjectsState = field(default_factory=ObjectsState)
    stamp_ns: int = 0
    objects: tuple = ()

    def frame(self, *detections, depth_m=None, grey=None, dt_ns=STEP_NS, tags=None, inverse_std=0.0):
        """Run one frame; ``depth_m`` is an image or a constant."""
        if isinstance(depth_m, float):
            depth_m = np.full(CAMERA.size, depth_m, np.float32)
        self.stamp_ns += dt_ns
        inputs = {"detections": detections, "tags": tags, "depth_m": depth_m, "grey": grey}
        scene = scene_of(CAMERA, limit_m=LIMIT_M, stamp_ns=self.stamp_ns, **inputs)
        self.state, out = step(self.cfg, self.state, replace(scene, inverse_depth_std=inverse_std))
        assert isinstance(out, Objects)
        self.objects = out.objects
        return self.objects

    @property
    def only(self):
        (item,) = self.objects
        return item


def depth_of(*objects):
    """(H, W) depth with boxes at their distances, the last in front."""
    depth = np.full(CAMERA.size, FAR_M, np.float32)
    for detection, distance_m in objects:
        x0, y0, x1, y1 = detection.box_px.rounded(CAMERA.width, CAMERA.height)
        depth[y0:y1, x0:x1] = distance_m
    return depth


def tags_of(*detections):
    tags = np.zeros(CAMERA.size, np.uint8)
    for detection in detections:
        x0, y0, x1, y1 = detection.box_px.rounded(CAMERA.width, CAMERA.height)
        tags[y0:y1, x0:x1] = VEHICLE
    return tags


def texture(seed=0, size=CAMERA.size):
    return np.random.default_rng(seed).integers(0, 256, size, np.uint8)


def moved(image, right, down):
    return np.roll(image, (down, right), axis=(0, 1))
