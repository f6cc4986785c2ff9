"""The layouts of datasets that ``roadperc-convert`` reads, one module each."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

from roadperc_stream.errors import DumpError

if TYPE_CHECKING:
    from .drive import Layout

LAYOUTS: Final = (
    "kitti-odometry",
    "kitti-raw",
    "kitti-object",
    "kitti-tracking",
    "tusimple",
    "culane",
    "cityscapes",
    "nuscenes",
    "carla-leaderboard",
    "bench2drive",
    "dump",
)
"""Names for ``--layout``, in the order of detection; the module of ``kitti-odometry`` is ``kitti_odometry``."""


def layout_of(folder: Path, name: str | None = None) -> "Layout":
    """Return the layout of a folder: the named one, else the first that fits; the dump, the last, always fits.

    Raises:
        DumpError: no layout has this name.
    """
    if name is not None and name not in LAYOUTS:
        raise DumpError(f"--layout {name}: expected one of {', '.join(LAYOUTS)}")
    candidates = map(_module, LAYOUTS if name is None else [name])
    return next(layout for layout in candidates if name or layout.detect(folder))


def _module(name: str) -> "Layout":
    return cast("Layout", import_module(f"{__name__}.{name.replace('-', '_')}"))
