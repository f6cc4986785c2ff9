"""What the chain will decode of a frame, decoded before its turn: that needs no memory of the frames before."""

from collections.abc import Iterator
from contextlib import suppress

from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Frame
from roadperc_stream.errors import DecodeError

Pixels = tuple[object, str]
"""An image or a cloud of points, and the property that decodes it once."""


def decode_ahead(cfg: ReplayConfig, frame: Frame) -> None:
    """Decode what the stages in use ask for; what cannot be decoded is left to the step, which says so."""
    for image, name in _asked(cfg, frame):
        with suppress(DecodeError):
            getattr(image, name)


def _asked(cfg: ReplayConfig, frame: Frame) -> Iterator[Pixels]:
    if needs_scene(cfg):
        yield from _of_scene(cfg, frame)
    if frame.image and needs_front_grey(cfg, frame):
        yield frame.image, "grey"
    if frame.right_camera and matches(cfg, frame):
        yield from ((image, "grey") for image in (frame.left, frame.right) if image)


def _of_scene(cfg: ReplayConfig, frame: Frame) -> Iterator[Pixels]:
    if frame.segmentation:
        yield frame.segmentation, "tags"
    if frame.depth:
        yield frame.depth, "depth_m"
    elif frame.points and frame.ego_T_lidar is not None and not matches(cfg, frame):
        yield frame.points, "points_m"
    if frame.instances and cfg.objects.enabled:
        yield frame.instances, "ids"


def needs_scene(cfg: ReplayConfig) -> bool:
    """Whether a stage in use looks at depth and tags: all do but stereo, which makes depth."""
    return any(stage.enabled for stage in (cfg.surface, cfg.odometry, cfg.lanes, cfg.objects, cfg.occupancy))


def needs_front_grey(cfg: ReplayConfig, frame: Frame) -> bool:
    """Whether a stage in use needs the front camera's pixels, whatever is remembered of the frames before."""
    searches = cfg.objects.enabled and cfg.objects.template_search and bool(frame.detections)
    shown = cfg.objects.enabled and bool(cfg.objects.template_png)
    return cfg.odometry.enabled or searches or shown or (matches(cfg, frame) and left_is_front(frame))


def matches(cfg: ReplayConfig, frame: Frame) -> bool:
    """Whether there is a pair to match."""
    return cfg.stereo.enabled and frame.right is not None


def left_is_front(frame: Frame) -> bool:
    """Whether the pair's left camera is the front camera, and not one of its own, whose image may be missing."""
    return frame.left is None and frame.left_camera == frame.camera
