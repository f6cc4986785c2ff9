"""Template matching: search for a tracked object by its last image patch, and for an obstacle by a given picture.

Sources: Lewis, Fast Normalized Cross-Correlation, 1995; OpenCV's matchTemplate with TM_CCOEFF_NORMED, which is 1 where
image and template differ only in brightness and contrast; the assignment "Environment Perception For Self-Driving Cars"
of the University of Toronto's course, in which the obstacle is at the best normalised cross-correlation and its
distance is the least depth there.
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
from roadperc_stream.model.frame import Frame

_FLAT = 0.5
"""Standard deviation in grey levels up to which pixels have no texture, only rounding errors."""
LARGEST_PX = 96
"""Longest side of a template: the middle of a larger object is enough to find it."""
_SMALLEST_PX = 8
"""Shortest side of a template: a smaller one matches everywhere."""
LABEL = "template"


@dataclass(frozen=True)
class Template:
    """(h, w) grey pixels of an object with sides ``sides_px``; ``off_px`` is the template's middle minus the object's.

    ``distance_m`` is the object's distance at that time, None if unknown.
    """

    grey: Image
    off_px: tuple[float, float]
    sides_px: tuple[float, float]
    distance_m: float | None

    def __post_init__(self) -> None:
        read_only(self.grey, np.uint8, (None, None), "template")

    def search(self, image_grey: Image, around: Box, scale: float) -> Correlation | None:
        """The correlation with an image in which the object is ``scale`` times as large; None if flat or too large.

        Args:
            image_grey: (H, W) uint8.
            around: search area for the object's middle.
            scale: factor of the template's size.
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
        """The whole object's box if the template, ``scale`` times as large, lies at ``box_px``."""
        x, y = (off * scale for off in self.off_px)
        centre_x, centre_y = (box_px.x_min + box_px.x_max) / 2 - x, (box_px.y_min + box_px.y_max) / 2 - y
        width, height = (side * scale for side in self.sides_px)
        return Box(centre_x - width / 2, centre_y - height / 2, centre_x + width / 2, centre_y + height / 2)


def correlate(image: Image, template: Image, around: Box) -> Correlation | None:
    """The correlation of a template with an image at all positions in a box.

    Args:
        image: (H, W) grey.
        template: (h, w) grey.
        around: box that must contain the whole template; it is clipped to the image.

    Returns:
        None if the template is empty or flat, or larger than the box.
    """
    x0, y0, x1, y1 = around.rounded(image.shape[1], image.shape[0])
    rows, columns = template.shape
    if not template.size or columns > x1 - x0 or rows > y1 - y0 or float(template.std()) <= _FLAT:
        return None
    window = image[y0:y1, x0:x1]
    scores = np.asarray(cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED), np.float32)
    # Where the image is flat, the correlation is 0 / 0, and OpenCV may return 1.
    scores[_flat(window, rows, columns)] = -np.inf
    row, column = np.unravel_index(int(scores.argmax()), scores.shape)
    if np.isfinite(scores[row, column]):
        scores[row, column] = _score(window[row : row + rows, column : column + columns], template)
    return Correlation(x0, y0, (columns, rows), scores)


def _score(pixels: Image, template: Image) -> float:
    """The score at one position, in integers: OpenCV's has an error up to 1e-5 that depends on the processor."""
    one, other = (np.ravel(values).astype(np.int64) for values in (pixels, template))
    sums, count = (int(one.sum()), int(other.sum())), one.size
    common = count * int(one @ other) - sums[0] * sums[1]
    spreads = [count * int(values @ values) - total**2 for values, total in zip((one, other), sums, strict=True)]
    return common / (math.sqrt(spreads[0]) * math.sqrt(spreads[1]))


def _flat(image: Image, rows: int, columns: int) -> Mask:
    """Positions (top left corners) at which a template of that size covers pixels without texture."""
    sums, squares = cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    total, total_of_squares = (_sums(np.asarray(table, float), rows, columns) for table in (sums, squares))
    count = rows * columns
    total_of_squares *= count
    total_of_squares -= np.square(total, out=total)
    flat: Mask = total_of_squares <= (_FLAT * count) ** 2
    return flat


def _sums(table: Float, rows: int, columns: int) -> Float:
    """Sums over (rows, columns) pixels from each position, from an integral image."""
    sums: Float = table[rows:, columns:] - table[:-rows, columns:]
    sums -= table[rows:, :-columns]
    sums += table[:-rows, :-columns]
    return sums


def cut(image_grey: Image, box_px: Box, distance_m: float | None) -> Template | None:
    """The template from the middle of a box, at most ``LARGEST_PX`` in each direction; None if it is too small."""
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
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(grey, (columns, rows), interpolation=interpolation), np.uint8)


def find_obstacle(cfg: ObjectsConfig, frame: Frame) -> tuple[Object | None, Correlation | None]:
    """The obstacle of ``objects.template_png`` with the correlation as its score, and the correlation everywhere.

    Both are None without a template or a grey image; the obstacle is None below ``objects.template_min_score``.
    """
    template = picture(cfg.template_png) if cfg.template_png else None
    if template is None or frame.grey is None:
        return None, None
    correlation = correlate(frame.grey, template, Box(0.0, 0.0, frame.camera.width, frame.camera.height))
    found = None if correlation is None else correlation.match(cfg.template_min_score)
    if found is None:
        return None, correlation
    box_px, score = found
    detection = Detection(LABEL, box_px, score)
    measured = _measured(cfg, frame, box_px)
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
    """(h, w) grey pixels of a PNG in base 64; None if it cannot be decoded."""
    try:
        data = np.frombuffer(base64.b64decode(png, validate=True), np.uint8)
    except binascii.Error:
        return None
    pixels = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    return None if pixels is None else np.asarray(pixels, np.uint8)


def png_of(grey: Image) -> str:
    """A PNG in base 64 of (h, w) grey pixels."""
    return base64.b64encode(cv2.imencode(".png", grey)[1].tobytes()).decode()


def _measured(cfg: ObjectsConfig, frame: Frame, box_px: Box) -> Measured:
    """The quantile of the distances of the box's pixels, or of their depths along the camera's axis."""
    if frame.depth_m is None:
        return Measured()
    box = box_px.rounded(frame.camera.width, frame.camera.height)
    if cfg.template_distance == "ray":
        return nearest(cfg, of_box(frame.camera, frame.depth_m, box, frame.depth_limit_m), frame.inverse_depth_std)
    x0, y0, x1, y1 = box
    depths_m = within_range(frame.depth_m[y0:y1, x0:x1], frame.depth_limit_m)
    return nearest(cfg, depths_m, frame.inverse_depth_std)
