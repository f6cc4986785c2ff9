"""What of a frame the stages in use ask for, whatever is remembered of the frames before."""

from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Frame


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
