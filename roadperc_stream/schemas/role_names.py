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
_FILLERS: Final = frozenset(["map", "maps", "raw", "png", "gt"])
_WORDS_OF: Final = {
    "instances": frozenset(["instance", "instances"]),
    "depth": frozenset(["depth", "depths", "depthmap"]),
    "segmentation": frozenset(["segmentation", "seg", "sem", "semantic", "semantics", "semseg", "labels", "tags"]),
    "detections": frozenset(["detections", "detection", "boxes", "bboxes"]),
    "lidar": frozenset(["lidar", "velodyne", "pointcloud", "pointclouds", "point", "points", "cloud", "clouds"]),
}
_SENSOR_WORDS: Final = frozenset[str]().union(*_WORDS_OF.values())
_KITTI: Final = {("image", 2): "image", ("image", 3): "right", ("label", 2): "detections"}
"""KITTI's camera numbers: 2 is the left colour camera, 3 the right one."""


def names_other_sensor(name: str) -> bool:
    """Return True if a word of the name is that of a sensor other than a camera, such as ``depth_rear``."""
    return not _SENSOR_WORDS.isdisjoint(re.findall(r"[a-z]+", name.lower()))


def role_of(name: str) -> str | None:
    """Return the role of a folder's or file's name; None if a word is unknown, or the name fits several roles.

    Case, underscores and CamelCase do not matter. ``depth_rear`` and ``semantic_lidar`` are other sensors.
    """
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+", name)
    words = [part.lower() for part in parts if not part.isdigit()]
    numbers = [int(part) for part in parts if part.isdigit()]
    if len(words) == 1 and len(numbers) == 1:
        return _KITTI.get((words[0], numbers[0]))
    return None if numbers or not words else _role_of_words(frozenset(words))


def _role_of_words(words: frozenset[str]) -> str | None:
    if words & _WORDS_OF["instances"]:
        # CARLA's sensor is called instance_segmentation.
        words -= _WORDS_OF["segmentation"]
    named = [role for role, known in _WORDS_OF.items() if words & known]
    sides = sorted(words & {"left", "right"})
    rest = words.difference(*_WORDS_OF.values(), {"left", "right"})
    if len(named) + len(sides) > 1 or not rest <= _CAMERA | _FILLERS:
        return None
    if named:
        return None if "rgb" in rest or (named == ["lidar"] and rest & _IMAGE_WORDS) else named[0]
    return sides[0] if sides else ("image" if rest & _CAMERA else None)
