"""Realistic sensors and networks: noise in clean pictures, and a detector with errors."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera, Float, Float32, inverse, project, transform

from .faces import Body
from .ground import FAR_M
from .object_truth import ObjectTruth
from .options import Exposure
from .view import Snapshot

Tags = NDArray[np.uint8]

REFERENCE_WIDTH: Final = 1280
WOBBLE_CELL_PX: Final = 22
"""Correlation length of the displacement of borders, at the reference width."""
WOBBLE_PX: Final = 75.0
"""Standard deviation of borders per share of noise, at the reference width: 1.5 px at 0.02."""
BLOB_RADIUS_PX: Final = (6.0, 34.0)
SALT: Final = 0.03
"""Single wrong pixels as a share of the noise."""


def noisy_tags(tags: Tags, share: float, rng: np.random.Generator) -> Tags:
    """Return (H, W) tags with the errors of a network: displaced borders, blobs of other classes, single wrong pixels.

    The blobs cover ``share`` of the image. The displacement of the borders is proportional to it.
    """
    scale = tags.shape[1] / REFERENCE_WIDTH
    classes = np.flatnonzero(np.bincount(tags.ravel()))
    result = _wobbled(tags, WOBBLE_PX * share * scale, WOBBLE_CELL_PX * scale, rng)
    wrong, area = np.full(tags.shape, 255, np.uint8), 0.0
    while area < share * tags.size:
        low, high = (radius * scale for radius in BLOB_RADIUS_PX)
        axes = rng.uniform(low, high, 2)
        x, y = (round(c) for c in rng.uniform((0, 0), tags.shape[::-1]))
        a, b = (max(round(c), 1) for c in axes)
        cv2.ellipse(wrong, (x, y), (a, b), float(rng.uniform(0, 180)), 0, 360, int(rng.choice(classes)), -1)
        area += float(np.pi * axes.prod())
    wrong = _wobbled(wrong, 3.0 * scale, WOBBLE_CELL_PX * scale / 2, rng)
    np.copyto(result, wrong, where=wrong != 255)
    salt = rng.integers(0, tags.size, round(SALT * share * tags.size))
    result.ravel()[salt] = rng.choice(classes, len(salt))
    return result


def _wobbled(tags: Tags, deviation_px: float, cell_px: float, rng: np.random.Generator) -> Tags:
    """Return tags with each pixel taken from a nearby position; the displacement is smooth over a cell."""
    height, width = tags.shape
    cells = (max(int(width / cell_px), 1) + 3, max(int(height / cell_px), 1) + 3)
    shifts = []
    for _ in range(2):
        coarse = rng.standard_normal((cells[1], cells[0]), np.float32)
        fine = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        shifts.append(fine * np.float32(deviation_px / max(float(fine.std()), 1e-6)))
    columns, rows = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    moved = cv2.remap(tags, shifts[0] + columns, shifts[1] + rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.uint8)


def noisy_depth(depth_m: Float32, relative_std: float, rng: np.random.Generator) -> Float32:
    """Return depth with an independent relative error in each pixel; the sky stays unchanged."""
    factor = rng.standard_normal(depth_m.shape, np.float32) * np.float32(relative_std) + np.float32(1)
    return np.where(depth_m >= FAR_M, FAR_M, np.clip(depth_m * factor, 0, FAR_M)).astype(np.float32)


def noisy_rgb(rgb: NDArray[np.uint8], std: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return colours with independent noise; ``std`` is in grey levels."""
    noise = rng.standard_normal(rgb.shape, np.float32) * np.float32(std)
    return np.clip(np.rint(rgb + noise), 0, 255).astype(np.uint8)


GAIN: Final = (0.5, 2.0)
OFFSET: Final = 12.0
"""Range of the gain of an exposure, and largest offset to either side, grey levels."""
BLACK_S: Final = 0.25
"""Length of a blackout."""


def exposed(rgb: NDArray[np.uint8], gain: float, offset: float) -> NDArray[np.uint8]:
    """Return colours at another exposure."""
    return np.asarray(np.clip(np.rint(rgb * np.float32(gain) + np.float32(offset)), 0, 255), np.uint8)


def exposure_at(kind: Exposure, time_s: float, frame: int, seed: int) -> tuple[float, float]:
    """Return gain and offset of a frame.

    ``steps`` changes both every second and ``frames`` in every frame. ``blackouts`` ends every two seconds with black.
    """
    if kind == "blackouts":
        return float(time_s % 2.0 < 2.0 - BLACK_S), 0.0
    rng = np.random.default_rng((seed, 102, int(time_s) if kind == "steps" else frame))
    return float(np.exp(rng.uniform(*np.log(GAIN)))), float(rng.uniform(-OFFSET, OFFSET))


MISSED: Final = 0.05
JITTER: Final = 0.03
"""Standard deviation of each box side as a share of the box's size."""
BEYOND_IMAGE: Final = 0.5
"""Share of the boxes at the image's border that are not clipped to the image."""
OCCLUDED_FOUND: Final = 0.35
OCCLUDED_MIN_PX: Final = 0.012
"""Smallest occluded body that is detected, as a share of the image's width."""
OCCLUDED_MAX_M: Final = 70.0
FALSE_PER_FRAME: Final = 2.2

Box = tuple[float, float, float, float]
Detected = tuple[str, Box, float]
"""Label, half-open box in pixels, and score."""


def detect(
    snapshot: Snapshot, camera: Camera, world_T_camera: Float, seen: Sequence[ObjectTruth], rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Return the detections of a frame as in ``detections.json``, the best first."""
    detections: list[Detected] = [
        (truth.label, _jittered(truth.box_px, camera, rng), float(rng.uniform(0.55, 0.99)))
        for truth in seen
        if rng.random() >= MISSED
    ]
    visible = {truth.name for truth in seen}
    hidden = [body for body in snapshot.bodies if body.name not in visible]
    detections += _occluded(hidden, camera, world_T_camera, rng)
    detections += [false_detection(camera.width, camera.height, rng) for _ in range(rng.poisson(FALSE_PER_FRAME))]
    return [
        {"label": label, "box_px": [round(c, 2) for c in box], "score": round(score, 4)}
        for label, box, score in sorted(detections, key=lambda detected: -detected[2])
    ]


def _jittered(box: Box, camera: Camera, rng: np.random.Generator) -> Box:
    """Return the box with a random error on each side; at the image's border it can extend beyond the image."""
    width, height = box[2] - box[0], box[3] - box[1]
    x0, y0, x1, y1 = np.asarray(box) + rng.normal(0, JITTER, 4) * (width, height, width, height)
    whole = (float(x0), float(y0), float(max(x1, x0 + 1)), float(max(y1, y0 + 1)))
    left, right = (float(np.clip(x, 0, camera.width)) for x in (whole[0], whole[2]))
    top, bottom = (float(np.clip(y, 0, camera.height)) for y in (whole[1], whole[3]))
    beyond = rng.random() < BEYOND_IMAGE or right - left < 1 or bottom - top < 1
    return whole if beyond else (left, top, right, bottom)


def _occluded(
    hidden: Sequence[Body], camera: Camera, world_T_camera: Float, rng: np.random.Generator
) -> Iterator[Detected]:
    """Yield some of the hidden bodies, with the box of the whole body."""
    for body in hidden:
        box = whole_box(body, camera, world_T_camera)
        if box is not None and box[2] - box[0] >= OCCLUDED_MIN_PX * camera.width and rng.random() < OCCLUDED_FOUND:
            yield body.label, _jittered(box, camera, rng), float(rng.uniform(0.35, 0.75))


def whole_box(body: Body, camera: Camera, world_T_camera: Float) -> Box | None:
    """Return the box of a whole body with its hidden parts; None outside the image, behind the camera or far away."""
    points = transform(inverse(world_T_camera), body.faces.corners.reshape(-1, 3))
    if points[:, 2].min() < 0.5 or points[:, 2].min() > OCCLUDED_MAX_M:
        return None
    (x0, y0), (x1, y1) = project(camera, points).min(axis=0), project(camera, points).max(axis=0)
    inside = x1 > 0 and y1 > 0 and x0 < camera.width and y0 < camera.height
    return (float(x0), float(y0), float(x1), float(y1)) if inside else None


def false_detection(columns: int, rows: int, rng: np.random.Generator) -> Detected:
    """Return a false detection: a box of a likely shape at a random position in an image of this size."""
    label = "Car" if rng.random() < 0.6 else "Pedestrian"
    height = rows * float(np.exp(rng.uniform(np.log(0.03), np.log(0.2))))
    width = height * float(rng.uniform(1.0, 2.2) if label == "Car" else rng.uniform(0.3, 0.55))
    x, y = rng.uniform(0, columns), rows * rng.uniform(0.2, 0.8)
    box = (float(x) - width / 2, float(y) - height / 2, float(x) + width / 2, float(y) + height / 2)
    return label, box, float(rng.uniform(0.3, 0.75))
