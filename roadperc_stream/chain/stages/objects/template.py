"""Template matching: the search for an object as it last looked, and for an obstacle that a picture shows.

Source: Lewis, Fast Normalized Cross-Correlation, 1995; OpenCV's matchTemplate with TM_CCOEFF_NORMED, which is 1 where
the image is the template but for brightness and contrast.

Source: the assignment "Environment Perception For Self-Driving Cars" of the University of Toronto's course: the
template's best normalised cross-correlation is the obstacle, the least depth there its distance.
"""

import base64
import binascii
import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from roadperc_stream.chain.stages.objects.regions import Measured, nearest, of_box, within_range
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Float
from roadperc_stream.model import Box, Correlation, Detection, Image, Mask, Object, read_only
from roadperc_stream.model.scene import Scene

_FLAT = 0.5
"""Standard deviation in grey levels up to which pixels have no texture: what is left of rounding."""
LARGEST_PX = 96
"""Longest side that is kept: the middle of a larger object is enough to find it."""
_SMALLEST_PX = 8
"""Fewer pixels are found everywhere."""
LABEL = "template"


@dataclass(frozen=True)
class Template:
    """(h, w) grey pixels of an object of ``sides_px``, whose middle is ``off_px`` away from the object's.

    ``distance_m`` is how far the object was then, None where that was not known.
    """

    grey: Image
    off_px: tuple[float, float]
    sides_px: tuple[float, float]
    distance_m: float | None

    def __post_init__(self) -> None:
        read_only(self.grey, np.uint8, (None, None), "template")

    def search(self, image_grey: Image, around: Box, scale: float) -> Correlation | None:
        """How well it fits an image where the object is ``scale`` times as large; None where it is flat or too large.

        Args:
            image_grey: (H, W) uint8.
            around: where the object's middle may be.
            scale: 1 is the size at which it was cut out.
        """
        pixels = _resized(self.grey, scale)
        rows, columns = pixels.shape
        x, y = (off * scale for off in self.off_px)
        region = Box(
            around.x_min + x - columns / 2,
            around.y_min + y - rows / 2,
            around.x_max + x + columns / 2,
            around.y_max + y + rows / 2,
        )
        return correlate(image_grey, pixels, region)

    def whole(self, box_px: Box, scale: float) -> Box:
        """The whole object's box where the template, ``scale`` times as large, lies in a box."""
        x, y = (off * scale for off in self.off_px)
        centre_x, centre_y = (box_px.x_min + box_px.x_max) / 2 - x, (box_px.y_min + box_px.y_max) / 2 - y
        width, height = (side * scale for side in self.sides_px)
        return Box(centre_x - width / 2, centre_y - height / 2, centre_x + width / 2, centre_y + height / 2)


def correlate(image: Image, template: Image, around: Box) -> Correlation | None:
    """How well the template fits everywhere in a box.

    Args:
        image: (H, W) grey.
        template: (h, w) grey, what is searched for.
        around: where it may lie, wholly, clipped to the image.

    Returns:
        None where the template is empty or flat, or does not fit into the box.
    """
    x0, y0, x1, y1 = around.rounded(image.shape[1], image.shape[0])
    rows, columns = template.shape
    if not template.size or columns > x1 - x0 or rows > y1 - y0 or float(template.std()) <= _FLAT:
        return None
    window = image[y0:y1, x0:x1]
    scores = np.asarray(cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED), np.float32)
    # Where the image is flat a correlation is 0 / 0, for which OpenCV may say 1.
    scores[_flat(window, rows, columns)] = -np.inf
    row, column = np.unravel_index(int(scores.argmax()), scores.shape)
    if np.isfinite(scores[row, column]):
        scores[row, column] = _score(window[row : row + rows, column : column + columns], template)
    return Correlation(x0, y0, (columns, rows), scores)


def _score(pixels: Image, template: Image) -> float:
    """The score at one place, by whole numbers: OpenCV's is off by up to 1e-5, by how much depends on the processor."""
    one, other = (np.ravel(values).astype(np.int64) for values in (pixels, template))
    sums, count = (int(one.sum()), int(other.sum())), one.size
    common = count * int(one @ other) - sums[0] * sums[1]
    spreads = [count * int(values @ values) - total**2 for values, total in zip((one, other), sums, strict=True)]
    return common / (math.sqrt(spreads[0]) * math.sqrt(spreads[1]))


def _flat(image: Image, rows: int, columns: int) -> Mask:
    """At which positions (top left corners) a template of that size covers pixels without texture."""
    sums, squares = cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    total, total_of_squares = (_sums(np.asarray(table, float), rows, columns) for table in (sums, squares))
    count = rows * columns
    total_of_squares *= count
    total_of_squares -= np.square(total, out=total)
    flat: Mask = total_of_squares <= (_FLAT * count) ** 2
    return flat


def _sums(table: Float, rows: int, columns: int) -> Float:
    """Of (rows, columns) pixels from each on, by an integral image."""
    sums: Float = table[rows:, columns:] - table[:-rows, columns:]
    sums -= table[rows:, :-columns]
    sums += table[:-rows, :-columns]
    return sums


def cut(image_grey: Image, box_px: Box, distance_m: float | None) -> Template | None:
    """The middle of a box in the image, at most ``LARGEST_PX`` in either direction; None where it is too small."""
    height, width = image_grey.shape
    x0, y0, x1, y1 = box_px.rounded(width, height)
    x0, x1 = _middle(x0, x1)
    y0, y1 = _middle(y0, y1)
    if x1 - x0 < _SMALLEST_PX or y1 - y0 < _SMALLEST_PX:
        return None
    off_px = ((x0 + x1 - box_px.x_min - box_px.x_max) / 2, (y0 + y1 - box_px.y_min - box_px.y_max) / 2)
    sides_px = (box_px.x_max - box_px.x_min, box_px.y_max - box_px.y_min)
    return Template(image_grey[y0:y1, x0:x1].copy(), off_px, sides_px, distance_m)


def _middle(first: int, end: int) -> tuple[int, int]:
    cut_off = max(end - first - LARGEST_PX, 0)
    return first + cut_off // 2, end - (cut_off - cut_off // 2)


def _resized(grey: Image, scale: float) -> Image:
    rows, columns = (max(round(side * scale), 1) for side in grey.shape)
    if (rows, columns) == grey.shape:
        return grey
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(grey, (columns, rows), interpolation=how), np.uint8)


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
