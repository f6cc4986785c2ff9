"""Finds images that repeat while the car's pose or other sensors change: the camera, or its driver, is frozen.

A standing car also gives equal images if they have no noise, as rendered ones. Its pose is then constant.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from deflate import crc32
from numpy.typing import NDArray

from roadperc_stream.chain.stages.odometry.brightness import shows_nothing
from roadperc_stream.model import Absent, Reason
from roadperc_stream.model.frame import Frame

_EVERY: Final = 4
"""Every fourth row of depth and tags is compared, which is enough to notice a change."""
FROZEN: Final = Absent(Reason("odometry", "image_frozen"))
"""Odometry of a frame whose image repeats: the car does not stand."""
Marks = tuple[int | None, int | None, int | None, int | None]
"""CRC-32 of the car's pose, of depth, tags and detections; None for a missing one."""


@dataclass(frozen=True)
class ImageRepeats:
    """CRC-32 of the last image, the latest marks beside it, and whether it repeats while they changed."""

    image: int | None = None
    beside: Marks = (None, None, None, None)
    is_frozen: bool = False

    def after(self, frame: Frame) -> "ImageRepeats":
        """The state after one more frame; a frame without an image changes nothing."""
        if frame.grey is None:
            return self
        image, beside = _mark(frame.grey), _beside(frame)
        if image != self.image:
            return ImageRepeats(image, beside)
        is_frozen = self.is_frozen or (_changed(self.beside, beside) and not shows_nothing(frame.grey))
        pose, depth, tags, found = (old if new is None else new for old, new in zip(self.beside, beside, strict=True))
        return ImageRepeats(image, (pose, depth, tags, found), is_frozen)


def _beside(frame: Frame) -> Marks:
    if frame.pose_mark is not None:
        return frame.pose_mark, None, None, None
    depth = None if frame.raw_depth_m is None else _mark(frame.raw_depth_m[::_EVERY])
    tags = None if frame.tags is None else _mark(frame.tags[::_EVERY])
    detections = None if frame.detections is None else crc32(repr(frame.detections).encode())
    return None, depth, tags, detections


def _mark(values: NDArray[Any]) -> int:
    return crc32(np.ascontiguousarray(values).data)


def _changed(before: Marks, now: Marks) -> bool:
    """Whether the pose changed, or in a log without poses anything else: noise changes depth and tags, but no pose."""
    pairs = list(zip(before, now, strict=True))
    known = pairs[:1] if before[0] is not None else pairs
    return any(None not in pair and pair[0] != pair[1] for pair in known)
