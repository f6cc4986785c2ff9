"""Corruptions of depth, segmentation, detections, calibration, and of the times at which messages arrive."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import compress
from typing import Any, Final

import cv2
import numpy as np

from roadperc_stream.geometry import Float32, rigid
from roadperc_stream.geometry.rotations import rotation_from_vector
from roadperc_stream.model import Box, Detection, Transform
from roadperc_stream.schemas.roles import Kind
from roadperc_stream.system.time import seconds_to_ns

from ..scene.noise import false_detection, noisy_tags
from .draw import Draw
from .images import IMAGES, is_crashed

_HOLE_RADIUS: Final = (0.01, 0.06)
"""Half axes of a hole, as shares of the image's width."""
_FROM_IMAGE: Final = ("tags", "instances", "detections")
"""Kinds that are computed from the image: a crashed camera sends none."""
Detections = tuple[Detection, ...]
Transforms = tuple[Transform, ...]


def depth_noise(depth_m: Float32, relative_std: float, draw: Draw) -> Float32:
    """Depth with an independent relative error in each pixel."""
    factor = 1 + relative_std * draw.rng("message").standard_normal(depth_m.shape, np.float32)
    return np.asarray(depth_m * np.maximum(factor, 0), np.float32)


def depth_holes(depth_m: Float32, share: float, draw: Draw) -> Float32:
    """Depth that is unknown in random ellipses, which cover at least a share of the image."""
    rng, (height, width) = draw.rng("message"), depth_m.shape
    holes = np.zeros(depth_m.shape, np.uint8)
    while holes.mean() < share:
        centre = rng.integers(0, (width, height))
        axes = np.maximum(rng.uniform(*_HOLE_RADIUS, 2) * width, 1).astype(int)
        cv2.ellipse(holes, centre.tolist(), axes.tolist(), float(rng.uniform(0, 180)), 0, 360, 1, -1)
    return np.where(holes > 0, np.float32(np.nan), depth_m)


def detections_jittered(found: Detections, std: float, draw: Draw) -> Detections:
    """Boxes with a random error on each side; a box is at least one pixel wide and high."""
    corners = np.array([(d.box_px.x_min, d.box_px.y_min, d.box_px.x_max, d.box_px.y_max) for d in found]).reshape(-1, 4)
    sides = np.tile(corners[:, 2:] - corners[:, :2], 2)
    corners += draw.rng("message").normal(0, std, corners.shape) * sides
    corners[:, 2:] = np.maximum(corners[:, 2:], corners[:, :2] + 1)
    return tuple(replace(item, box_px=Box(*box)) for item, box in zip(found, corners.tolist(), strict=True))


def detections_false(found: Detections, mean: float, draw: Draw) -> Detections:
    """Detections with boxes of likely shapes at random positions."""
    rng, camera = draw.rng("message"), draw.cameras[0]
    false = (false_detection(camera.width, camera.height, rng) for _ in range(rng.poisson(mean)))
    return (*found, *(Detection(label, Box(*box), score) for label, box, score in false))


def calibration_turned(edges: Transforms, degrees: float, draw: Draw) -> Transforms:
    """The cameras' mountings, turned about one random axis, the same in the whole log."""
    axis, frames = draw.rng("log").standard_normal(3), {camera.frame_id for camera in draw.cameras}
    turn = rigid(rotation_from_vector(np.radians(degrees) * axis / np.linalg.norm(axis)), np.zeros(3))
    return tuple(
        replace(edge, parent_T_child=edge.parent_T_child @ turn) if edge.child in frames else edge for edge in edges
    )


CONTENTS: Final[Mapping[Kind, Mapping[str, Callable[[Any, Any, Draw], Any]]]] = {
    "image": IMAGES,
    "depth": {"depth_noise": depth_noise, "depth_holes": depth_holes},
    "tags": {"tag_noise": lambda tags, share, draw: noisy_tags(tags, share, draw.rng("message"))},
    "detections": {
        "detections_jittered": detections_jittered,
        "detections_missed": lambda found, p, draw: tuple(compress(found, draw.rng("message").random(len(found)) >= p)),
        "detections_false": detections_false,
    },
    "tf": {"calibration_turned": calibration_turned},
}
"""By kind and name: the function of the content, the constants of the severity, and the random numbers."""

Delays = tuple[int, ...]
"""When a message arrives, in nanoseconds after its log time; empty if it is lost."""


DELIVERIES: Final[Mapping[str, Callable[[Kind, Any, Draw], Delays]]] = {
    "camera_crash": lambda kind, share, draw: () if kind in _FROM_IMAGE and is_crashed(share, draw) else (0,),
    "frame_drop": lambda _, share, draw: () if draw.rng("stamp").random() < share else (0,),
    "messages_late": lambda _, late_s, draw: (seconds_to_ns(late_s) if draw.rng("message").random() < 0.2 else 0,),
    "messages_lost": lambda _, share, draw: () if draw.rng("message").random() < share else (0,),
    "messages_twice": lambda _, share, draw: (0, 0) if draw.rng("message").random() < share else (0,),
    "messages_out_of_order": lambda _, most_s, draw: (seconds_to_ns(draw.rng("message").uniform(0, most_s)),),
}
"""By name: the function of the message's kind, the constants of the severity, and the random numbers."""
