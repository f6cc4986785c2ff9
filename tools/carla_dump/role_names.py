"""The usual names of folders in a dump, and their roles."""

import re
from typing import Final

ROLES: Final = (
    "image",
    "depth",
    "segmentation",
    "instances",
    "left",
    "right",
    "detections",
    "lidar",
    "truth_depth",
    "truth_segmentation",
)
"""Roles of files; ``--role`` accepts these names."""

_IMAGE_WORDS: Final = frozenset(
    {"rgb", "image", "images", "img", "imgs", "color", "colour", "colors", "frame", "frames"}
)
_CAMERA: Final = _IMAGE_WORDS | {"camera", "cam", "sensor", "front"}
_DEPTH: Final = frozenset(["depth", "depths", "depthmap"])
_TAGS: Final = frozenset(["segmentation", "seg", "sem", "semantic", "semantics", "semseg", "labels", "tags"])
_INSTANCES: Final = frozenset(["instance", "instances"])
_DETECTIONS: Final = frozenset(["detections", "detection", "boxes", "bboxes"])
_LIDAR: Final = frozenset(["lidar", "velodyne", "pointcloud", "pointclouds", "point", "points", "cloud", "clouds"])
_FILLERS: Final = frozenset(["map", "maps", "raw", "png", "gt"])
_WORDS_OF: Final = {
    "instances": _INSTANCES,
    "depth": _DEPTH,
    "segmentation": _TAGS,
    "detections": _DETECTIONS,
    "lidar": _LIDAR,
}
_KITTI: Final = {("image", 2): "image", ("image", 3): "right", ("label", 2): "detections"}
"""KITTI's camera numbers: 2 is the left colour camera, 3 the right one."""


def role_of(name: str) -> str | None:
    """Return the role of a folder's or file's name; None if a word is unknown, or the name fits several roles.

    Case, underscores and CamelCase do not matter. ``depth_rear`` and ``semantic_lidar`` are other sensors.
    """
    words, numbers = _words(name)
    if len(words) == 1 and len(numbers) == 1:
        return _KITTI.get((words[0], numbers[0]))
    return None if numbers or not words else _role_of_words(frozenset(words))


def _words(name: str) -> tuple[list[str], list[int]]:
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+", name)
    return [p.lower() for p in parts if not p.isdigit()], [int(p) for p in parts if p.isdigit()]


def _role_of_words(words: frozenset[str]) -> str | None:
    if words & _INSTANCES:
        # CARLA's sensor is called instance_segmentation.
        words -= _TAGS
    named = [role for role, known in _WORDS_OF.items() if words & known]
    sides = sorted(words & {"left", "right"})
    rest = words.difference(*_WORDS_OF.values(), {"left", "right"})
    if len(named) + len(sides) > 1 or not rest <= _CAMERA | _FILLERS:
        return None
    if named:
        return None if "rgb" in rest or (words & _LIDAR and rest & _IMAGE_WORDS) else named[0]
    return sides[0] if sides else ("image" if rest & _CAMERA else None)
