"""A rendered drive, frame by frame, through the objects' stage, and what it found beside what is true."""

import json
from dataclasses import dataclass

import cv2
import numpy as np

from roadperc_stream.chain.stages.objects import ObjectsState, step
from roadperc_stream.geometry import Camera
from roadperc_stream.model import Box, Detection, Object
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14 as TABLE
from tests.analytic import STEP_NS
from tests.scenes import scene_of

MATCH_OVERLAP = 0.5
NEAR_M = 30.0


@dataclass(frozen=True)
class Found:
    """An object of a frame and the true one it stands for: the best overlap of its label, None below one half."""

    frame: int
    item: Object
    truth: dict | None
    overlap: float


@dataclass(frozen=True)
class Drive:
    found: list[Found]
    truths: list[list[dict]]


def read(folder, name):
    return json.loads((folder / f"{name}.json").read_text())


def camera_of(folder):
    calibration = read(folder, "calibration")
    (fx, _, cx), (_, fy, cy), _ = calibration["K"]
    return Camera("camera", calibration["width"], calibration["height"], fx, fy, cx - 0.5, cy - 0.5)


def pixels(folder, sensor, name):
    return cv2.imread(str(folder / sensor / f"{name}.png"))


def depth_m(folder, name):
    b, g, r = np.moveaxis(pixels(folder, "depth", name).astype(np.float32), 2, 0)
    return (r + 256 * g + 65536 * b) * np.float32(1000 / (2**24 - 1))


def detections_of(entries):
    return tuple(Detection(e["label"], Box(*e["box_px"]), e["score"]) for e in entries)


def through(cfg, folder, *, image=True):
    """Every kept object of a dump's frames."""
    camera, truth, detections = camera_of(folder), read(folder, "truth")["objects"], read(folder, "detections")
    state, found = ObjectsState(), []
    for index, name in enumerate(sorted(truth)):
        tags = np.ascontiguousarray(pixels(folder, "segmentation", name)[..., 2])
        grey = cv2.cvtColor(pixels(folder, "rgb", name), cv2.COLOR_BGR2GRAY) if image else None
        scene = scene_of(
            camera,
            tags=tags,
            table=TABLE,
            depth_m=depth_m(folder, name),
            limit_m=1000.0,
            grey=grey,
            detections=detections_of(detections[name]),
            stamp_ns=(index + 1) * STEP_NS,
        )
        state, objects = step(cfg, state, scene)
        found += [Found(index, item, *stands_for(item, truth[name])) for item in objects.objects if item.kept]
    return Drive(found, [truth[name] for name in sorted(truth)])


def stands_for(item, truths):
    scored = [
        (item.detection.box_px.overlap(Box(*t["box_px"])), k)
        for k, t in enumerate(truths)
        if t["label"] == item.detection.label
    ]
    overlap, k = max(scored, default=(0.0, 0))
    return (truths[k], overlap) if overlap >= MATCH_OVERLAP else (None, overlap)


def well_visible(found, camera):
    """A true object nearer than 30 m, whole in the image, whose distance of this frame is not a neighbour's.

    Where the image's border cuts an object its nearest visible point is not its nearest point; in a row of parked
    cars a box holds the pixels of the next one, too, and its quantile is that one's distance.
    """
    truth = found.truth
    if truth is None or found.item.distance_m is None or truth["distance_m"] > NEAR_M:
        return False
    x0, y0, x1, y1 = truth["box_px"]
    whole = min(x0, y0) > 2 and x1 < camera.width - 2 and y1 < camera.height - 2
    return whole and abs(found.item.distance_m - truth["distance_m"]) < max(0.3, 0.02 * truth["distance_m"])
