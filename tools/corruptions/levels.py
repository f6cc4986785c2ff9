"""The constants of every corruption, for severities 1 to 5.

Sources: ImageNet-C (Hendrycks and Dietterich, ICLR 2019) for the first nine; RoboBEV (Xie et al., 2023) for the
constants of ``low_light``, and for what ``camera_crash`` and ``frame_drop`` mean. The other constants are this
project's own.
"""

import argparse
import re
from collections.abc import Mapping
from typing import Any, Final

from roadperc_stream.system.text import nearest

LEVELS: Final[Mapping[str, tuple[Any, ...]]] = {
    "gaussian_noise": (0.08, 0.12, 0.18, 0.26, 0.38),  # standard deviation; 1 is white
    "shot_noise": (60, 25, 12, 5, 3),  # photons of a white pixel
    "impulse_noise": (0.03, 0.06, 0.09, 0.17, 0.27),  # share of the values that become black or white
    "defocus_blur": ((3, 0.1), (4, 0.5), (6, 0.5), (8, 0.5), (10, 0.5)),  # radius of the disk and of its edge, px
    "motion_blur": ((10, 3), (15, 5), (15, 8), (15, 12), (20, 15)),  # length and standard deviation, px
    "fog": ((1.5, 2), (2, 2), (2.5, 1.7), (2.5, 1.5), (3, 1.4)),  # density, and decay of its pattern
    "brightness": (0.1, 0.2, 0.3, 0.4, 0.5),  # added to the value of HSV
    "contrast": (0.4, 0.3, 0.2, 0.1, 0.05),  # factor
    "jpeg_compression": (25, 18, 15, 10, 7),  # quality
    # brightest value, photons of a white pixel, and standard deviation of the noise
    "low_light": ((0.6, 600, 0.008), (0.5, 250, 0.012), (0.4, 120, 0.018), (0.3, 50, 0.026), (0.2, 30, 0.038)),
    "camera_crash": (0.1, 0.2, 0.3, 0.4, 0.5),  # share of the log
    "frame_drop": (0.1, 0.2, 0.3, 0.4, 0.5),  # share of the frames
    "depth_noise": (0.01, 0.02, 0.05, 0.1, 0.2),  # relative standard deviation
    "depth_holes": (0.05, 0.1, 0.2, 0.35, 0.5),  # share of the image
    "tag_noise": (0.01, 0.02, 0.05, 0.1, 0.2),  # share of wrong pixels
    "detections_jittered": (0.03, 0.06, 0.1, 0.15, 0.25),  # standard deviation of a side, as a share of the box
    "detections_missed": (0.1, 0.2, 0.3, 0.5, 0.7),  # share
    "detections_false": (1, 2, 4, 8, 16),  # mean number per frame
    "calibration_turned": (0.25, 0.5, 1, 2, 4),  # degrees
    "messages_late": (0.05, 0.1, 0.2, 0.5, 2),  # delay in seconds of every fifth message
    "messages_lost": (0.02, 0.05, 0.1, 0.2, 0.4),  # share
    "messages_twice": (0.1, 0.2, 0.3, 0.4, 0.5),  # share
    "messages_out_of_order": (0.1, 0.2, 0.4, 0.8, 1.6),  # largest delay in seconds
}


def severities(text: str) -> dict[str, int]:
    """Parse corruptions with severities, such as ``fog=3,frame_drop=2``.

    Raises:
        ArgumentTypeError: a corruption does not exist or is given twice, or a severity is not 0 to 5.
    """
    found: dict[str, int] = {}
    for word in text.split(","):
        name, _, severity = (part.strip() for part in word.partition("="))
        if name not in LEVELS:
            near = nearest(name, LEVELS)
            hint = f"did you mean {near}?" if near else f"known: {', '.join(LEVELS)}"
            raise argparse.ArgumentTypeError(f"no corruption {name!r}; {hint}")
        if name in found or not re.fullmatch("[0-5]", severity):
            raise argparse.ArgumentTypeError(f"{word.strip()}: expected NAME=SEVERITY once, with a severity of 0 to 5")
        found[name] = int(severity)
    return found


def swept(text: str) -> tuple[str, tuple[int, ...]]:
    """Parse a corruption with several severities, such as ``fog=1,3,5``; severity 0 is always part of a sweep.

    Raises:
        ArgumentTypeError: as ``severities``.
    """
    name, _, values = text.partition("=")
    found = {severity for value in values.split(",") for severity in severities(f"{name}={value}").values()}
    return name.strip(), tuple(sorted(found - {0}))
