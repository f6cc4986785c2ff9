"""An obstacle that a picture shows, searched for in the whole of every frame: its place, distance and correlation.

Source: the assignment "Environment Perception For Self-Driving Cars" of the University of Toronto's course: the
template's best normalised cross-correlation is the obstacle, the least depth there its distance.
"""

import base64
import binascii
from functools import lru_cache

import cv2
import numpy as np

from roadperc_stream.chain.stages.objects.distance import Measured, nearest, of_box, within_range
from roadperc_stream.chain.stages.objects.template_matching import correlate
from roadperc_stream.core.config import ObjectsConfig
from roadperc_stream.core.datatypes import Box, Correlation, Detection, Image, Object
from roadperc_stream.core.scene import Scene

LABEL = "template"


def find_obstacle(cfg: ObjectsConfig, scene: Scene) -> tuple[Object | None, Correlation | None]:
    """The obstacle where it is found, its score being the correlation; and the correlation everywhere.

    Args:
        cfg: the template as a PNG, and how well it must fit.
        scene: the frame; nothing is found without its grey image.
    """
    template = picture(cfg.template_png) if cfg.template_png else None
    if template is None or scene.grey is None:
        return None, None
    correlation = correlate(scene.grey, template, Box(0.0, 0.0, scene.camera.width, scene.camera.height))
    found = None if correlation is None else correlation.match(cfg.template_min_score)
    if found is None:
        return None, correlation
    box_px, score = found
    detection = Detection(LABEL, box_px, score)
    measured = _measured(cfg, scene, box_px)
    obstacle = Object(
        detection,
        kept=True,
        distance_m=measured.distance_m,
        distance_std_m=measured.std_m,
        beyond_range=measured.beyond_range,
        status="tracked",
    )
    return obstacle, correlation


@lru_cache(maxsize=4)
def picture(png: str) -> Image | None:
    """(h, w) grey pixels of a PNG in base 64; None where it is none."""
    try:
        data = np.frombuffer(base64.b64decode(png, validate=True), np.uint8)
    except binascii.Error:
        return None
    pixels = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    return None if pixels is None else np.asarray(pixels, np.uint8)


def png_of(grey: Image) -> str:
    """A PNG in base 64 of (h, w) grey pixels."""
    return base64.b64encode(cv2.imencode(".png", grey)[1].tobytes()).decode()


def _measured(cfg: ObjectsConfig, scene: Scene, box_px: Box) -> Measured:
    """The quantile of the distances of the box's pixels, or of their depths along the camera's axis."""
    if scene.depth_m is None:
        return Measured()
    box = box_px.rounded(scene.camera.width, scene.camera.height)
    if cfg.template_distance == "ray":
        return nearest(cfg, of_box(scene.camera, scene.depth_m, box, scene.depth_limit_m))
    x0, y0, x1, y1 = box
    return nearest(cfg, within_range(scene.depth_m[y0:y1, x0:x1], scene.depth_limit_m))
