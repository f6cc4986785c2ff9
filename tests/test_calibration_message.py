"""Which images a foxglove.CameraCalibration calls rectified."""

from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from roadperc_stream.decoding import camera_from_calibration
from roadperc_stream.encoding import encode_calibration
from roadperc_stream.geometry import Camera, Lens, rotation_from_rpy

PLAIN = Camera("right", 640, 480, 320.0, 321.0, 319.5, 239.5, 0.5)
TURN = tuple(float(r) for r in rotation_from_rpy(0.01, 0.02, 0.03).ravel())
DISTORTION = (0.1, -0.02, 0.001, 0.0, 0.0)


@pytest.mark.parametrize(
    "camera",
    [
        PLAIN,
        replace(PLAIN, distortion=DISTORTION),
        replace(PLAIN, distortion=DISTORTION, lens=Lens(310.0, 311.0, 318.0, 241.0, TURN, "plumb_bob")),
        replace(PLAIN, lens=Lens(320.0, 321.0, 319.5, 239.5, TURN)),
        replace(PLAIN, lens=Lens(310.0, 311.0, 318.0, 241.0)),
    ],
    ids=["rectified", "distorted, no R", "distorted", "turned", "another K"],
)
def test_a_camera_comes_back_as_it_was(camera):
    assert camera_from_calibration(CameraCalibration.FromString(encode_calibration(1, camera))) == camera


def test_an_R_of_zeros_is_none():
    message = CameraCalibration.FromString(encode_calibration(1, replace(PLAIN, distortion=DISTORTION)))
    message.R.extend(np.zeros(9))
    assert camera_from_calibration(message).lens is None
