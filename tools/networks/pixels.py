"""Pixels of an image as the input of a network, and their place in it."""

from dataclasses import dataclass

import cv2
import numpy as np

from roadperc_stream.errors import ConfigError
from roadperc_stream.geometry import Float, Float32
from roadperc_stream.model import Image

from .description import InputKeys, Network


@dataclass(frozen=True)
class Placement:
    """Where an image of ``size`` (columns, rows) is in the input of a network: x' = x * scale + offset."""

    size: tuple[int, int]
    scale: tuple[float, float]
    offset: tuple[int, int]

    def in_image(self, boxes: Float) -> Float:
        """(N, 4) boxes in pixels of the image, clipped to it, from boxes in pixels of the input."""
        found: Float = (boxes - np.tile(self.offset, 2)) / np.tile(self.scale, 2)
        return np.clip(found, 0.0, np.tile(self.size, 2))

    def cut(self, scores: Float32, input_size: tuple[int, int]) -> Float32:
        """(C, h', w') part of (C, h, w) scores that shows the image; the scores may be smaller than the input."""
        first = np.array(self.offset) * (share := scores.shape[:0:-1] / np.array(input_size))
        end = first + np.array(self.size) * self.scale * share
        (left, top), (right, bottom) = np.rint((first, np.maximum(end, first + 1))).astype(int)
        return scores[:, top:bottom, left:right]


def placement(keys: InputKeys, size: tuple[int, int]) -> Placement:
    """Return the place of an image of ``size`` (columns, rows) in the input.

    A network that is trained on squeezed images finds neither road nor markings in a much wider one. So such an image
    gets borders above and below first.
    """
    full = keys.size[0] / size[0], keys.size[1] / size[1]
    if keys.resize == "squeeze":
        rows = max(size[1], round(size[0] / max(keys.aspect, keys.size[0] / keys.size[1])))
        scale = full[0], keys.size[1] / rows
    else:
        scale = min(full), min(full)
    free = [keys.size[axis] - round(size[axis] * scale[axis]) for axis in (0, 1)]
    is_centred = keys.resize == "squeeze" or keys.align == "centre"
    column, row = (gap // 2 if is_centred else 0 for gap in free)
    return Placement(size, scale, (column, row))


def as_seen(keys: InputKeys, bgr: Image) -> Image:
    """(H, W, 3) uint8 input of an (H, W, 3) BGR image, in the network's order of colours, before mean and scale."""
    place = placement(keys, (bgr.shape[1], bgr.shape[0]))
    columns, rows = (max(round(side * scale), 1) for side, scale in zip(place.size, place.scale, strict=True))
    column, row = place.offset
    seen = np.full((*keys.size[::-1], 3), keys.pad, np.uint8)
    seen[row : row + rows, column : column + columns] = cv2.resize(bgr, (columns, rows))
    return seen[..., ::-1] if keys.colours == "rgb" else seen


def tensor(keys: InputKeys, seen: Image) -> Float32:
    """(1, 3, H, W) or (1, H, W, 3) float32 of the pixels that ``as_seen`` returns."""
    values = (seen.astype(np.float32) - np.array(keys.mean, np.float32)) * np.array(keys.scale, np.float32)
    return np.ascontiguousarray(values.transpose(2, 0, 1) if keys.layout == "NCHW" else values, np.float32)[None]


def require_orientation(network: Network, size: tuple[int, int]) -> None:
    """Check that a portrait input does not get landscape images: such exports have rows and columns swapped.

    Raises:
        ConfigError: it does.
    """
    columns, rows = network.keys.input.size
    if columns < rows and size[0] > size[1]:
        raise ConfigError(
            f"{network.path}: input of {columns} columns and {rows} rows is portrait, but the images are landscape "
            f"({size[0]}x{size[1]}); the model is probably exported with rows and columns swapped"
        )
