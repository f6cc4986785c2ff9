"""Small dumps with known content, in every format the converter reads."""

import json
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 16, 12
CALIBRATION = {"width": WIDTH, "height": HEIGHT, "fov_deg": 90, "carla_tags": "0.9.15"}
TAGS = np.tile(np.array([0, 1, 2, 14], np.uint8), (HEIGHT, WIDTH // 4))


def depth_m() -> np.ndarray:
    """(H, W) metres from 3.5 m, the nearest that logarithmic grey can say, to the far plane."""
    values = np.geomspace(3.5, 60.0, WIDTH * HEIGHT).reshape(HEIGHT, WIDTH)
    values[0] = 1000.0
    return values


def png(path: Path, pixels: np.ndarray, form: str = ".png") -> Path:
    """Write pixels in OpenCV's channel order; the suffix may lie."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(form, pixels)[1].tobytes())
    return path


def jpeg(path: Path, pixels: np.ndarray) -> Path:
    return png(path, pixels, ".jpg")


def npy(path: Path, values: np.ndarray) -> Path:
    """Write an array; the suffix may lie."""
    with path.open("wb") as stream:
        np.save(stream, values)
    return path


def alpha(pixels: np.ndarray) -> np.ndarray:
    """(H, W, 4) the same colours, opaque."""
    return np.dstack((pixels, np.full(pixels.shape[:2], 255, np.uint8)))


def camera_pixels(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)


def carla_codes(metres: np.ndarray) -> np.ndarray:
    """(H, W, 3) blue, green, red of CARLA's 24-bit depth."""
    codes = np.rint(metres / 1000.0 * (2**24 - 1)).astype(np.uint32)
    return np.stack((codes >> 16, codes >> 8 & 255, codes & 255), axis=-1).astype(np.uint8)


def red(tags: np.ndarray) -> np.ndarray:
    """(H, W, 3) image with tags in the red channel."""
    zero = np.zeros_like(tags)
    return np.stack((zero, zero, tags), axis=-1)


def document(path: Path, content: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))
    return path


def plain_dump(folder: Path, frames: tuple[int, ...] = (0, 1, 2)) -> Path:
    """A dump with image, depth and raw tags."""
    for number in frames:
        png(folder / "rgb" / f"{number:06d}.png", camera_pixels(number))
        png(folder / "depth" / f"{number:06d}.png", carla_codes(depth_m()))
        png(folder / "segmentation" / f"{number:06d}.png", red(TAGS))
    document(folder / "calibration.json", CALIBRATION)
    return folder
