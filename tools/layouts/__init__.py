"""The layouts of datasets that ``roadperc-convert`` reads.

To add a dataset, write a module with a ``LAYOUT`` (see ``dataset.Layout``). Add its name to ``LAYOUTS`` here, and the
layout to ``_IN_ORDER`` in ``known.py``: both lists have the same order. Add its rows to the tables in
``docs/recordings.md``, and a line to the help of ``cli/convert.py`` if its files are new.
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
