"""The layouts by name; a module of its own because ``--help`` needs only the names."""

from collections.abc import Mapping
from typing import Final

from . import (
    LAYOUTS,
    bench2drive,
    carla_leaderboard,
    cityscapes,
    culane,
    dump,
    kitti_benchmarks,
    kitti_odometry,
    kitti_raw,
    nuscenes,
    tusimple,
)
from .dataset import Layout

_IN_ORDER: Final = (
    kitti_odometry.LAYOUT,
    kitti_raw.LAYOUT,
    kitti_benchmarks.OBJECT,
    kitti_benchmarks.TRACKING,
    tusimple.LAYOUT,
    culane.LAYOUT,
    cityscapes.LAYOUT,
    nuscenes.LAYOUT,
    carla_leaderboard.LAYOUT,
    bench2drive.LAYOUT,
    dump.LAYOUT,
)
KNOWN: Final[Mapping[str, Layout]] = dict(zip(LAYOUTS, _IN_ORDER, strict=True))
