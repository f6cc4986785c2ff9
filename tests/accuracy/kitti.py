"""Converts KITTI's odometry data to a dump for ``roadperc-convert``, with true poses."""

import shutil

import cv2
import numpy as np

from roadperc_stream.geometry import inverse
from roadperc_stream.tools.scene import dump

HEIGHT_M = 1.65
RATE_HZ = 10.0
EGO_T_CAMERA = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, HEIGHT_M], [0, 0, 0, 1]], float)
"""A level camera that looks ahead: x to the right, y down."""


def write_dump(source, target):
    """Write the left grey images, their calibration and the car's poses from a folder in KITTI's layout."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source / "image_0", target / "rgb")
    pictures = sorted((target / "rgb").iterdir())
    height, width = cv2.imread(str(pictures[0])).shape[:2]
    P = np.array((source / "calib.txt").read_text().split()[1:13], float).reshape(3, 4)
    calibration = {
        "width": width,
        "height": height,
        "K": P[:, :3].tolist(),
        "pixel_origin": "centre",
        "rate_hz": RATE_HZ,
        "mounting": {"rgb": {"x": 0.0, "y": 0.0, "z": HEIGHT_M, "roll": 0.0, "pitch": 0.0, "yaw": 0.0}},
    }
    dump.write_json(target / "calibration.json", calibration)
    poses = {
        picture.stem: dump.carla_transform(ego_pose(line))
        for picture, line in zip(pictures, (source / "poses.txt").read_text().splitlines(), strict=True)
    }
    dump.write_json(target / "poses.json", poses)


def ego_pose(line):
    """The (4, 4) pose of the car relative to the first frame, from a line of KITTI's pose file."""
    first_T_camera = np.vstack([np.array(line.split(), float).reshape(3, 4), [0, 0, 0, 1]])
    return EGO_T_CAMERA @ first_T_camera @ inverse(EGO_T_CAMERA)
