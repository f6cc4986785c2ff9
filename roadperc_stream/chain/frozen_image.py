"""Finds images that repeat while the car's pose or other sensors change: the camera, or its driver, is frozen.

A standing car also gives equal images if they have no noise, as rendered ones. Its pose is then constant.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.odometry.brightness import shows_nothing
from roadperc_stream.model import Absent, Reason
from roadperc_stream.model.scene import Scene

_EVERY: Final = 4
"""Every fourth row of depth and tags is compared, which is enough to notice a change."""
FROZEN: Final = Absent(Reason("odometry", "image_frozen"))
"""Odometry of a frame whose image repeats: the car does not stand."""


@dataclass(frozen=True)
class ImageRepeats:
    """CRC-32 of the last image and of what is known beside it, and whether the image repeats while that changed."""

    image: int | None = None
    beside: Mapping[str, int] = field(default_factory=dict)
    is_frozen: bool = False

    def after(self, scene: Scene) -> "ImageRepeats":
        """The state after one more frame; a frame without an image changes nothing."""
        if scene.grey is None:
            return self
        image, beside = _mark(scene.grey), _marks(scene)
        if image != self.image:
            return ImageRepeats(image, beside)
        compared = beside.keys() & ({"pose"} if "pose" in self.beside else self.beside)
        changed = any(beside[name] != self.beside[name] for name in compared)
        is_frozen = self.is_frozen or (changed and not shows_nothing(scene.grey))
        return ImageRepeats(image, {**self.beside, **beside}, is_frozen)


def _marks(scene: Scene) -> dict[str, int]:
    """The car's pose alone if it is known: noise changes depth and tags, but no pose."""
    if scene.pose_mark is not None:
        return {"pose": scene.pose_mark}
    depth_m = None if scene.depth is None else scene.depth.depth_m
    images: dict[str, NDArray[Any] | None] = {"depth": depth_m, "tags": scene.tags}
    marks = {name: _mark(values[::_EVERY]) for name, values in images.items() if values is not None}
    if scene.detections is not None:
        marks["detections"] = zlib.crc32(repr(scene.detections).encode())
    return marks


def _mark(values: NDArray[Any]) -> int:
    return zlib.crc32(np.ascontiguousarray(values).data)
