"""The course's stereo pair as its public solutions take it: red and blue swapped, block matching by their settings."""

import shutil

import cv2


def write_dump(source, target):
    """The pair as a dump that ``roadperc-convert`` reads, with red and blue swapped."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    shutil.copy(source / "calibration.json", target)
    for name in ("left.png", "right.png"):
        cv2.imwrite(str(target / name), cv2.imread(str(source / name))[..., ::-1])


TEMPLATE = "0:547,479,593,509"
"""The obstacle's picture, a box in the only frame, as ``roadperc-replay --template`` takes it."""
SETTINGS = (
    "stereo.method=full",
    "stereo.disparities=96",
    "stereo.block_px=11",
    "stereo.p1=864",
    "stereo.p2=3456",
    "stereo.uniqueness_percent=0",
    "stereo.speckle_px=0",
    "stereo.refine_px=0",
    "objects.distance_quantile=0",
    "objects.template_distance=depth",
)
