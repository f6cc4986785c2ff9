"""The layouts of datasets that ``roadperc-convert`` reads.

To add a dataset, write a module with a ``LAYOUT`` (see ``dataset.Layout``). Add its name here, the layout to
``known.py`` and a row to the table in ``docs/recordings.md``.
"""

from typing import Final

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
"""Names for ``--layout``, in the order of detection; the dump, the last, fits every folder."""
