"""Which images a foxglove.CameraCalibration calls rectified."""

import re
from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Camera, Lens
from roadperc_stream.geometry.rectification import is_rectified, lens_fault, rectified
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input.decoding import camera_from_calibration
from roadperc_stream.output.encoding import encode_calibration

PLAIN = Camera("right", 640, 480, 320.0, 321.0, 319.5, 239.5, 0.5)
TURN = tuple(float(r) for r in rotation_from_rpy(0.01, 0.02, 0.03).ravel())
DISTORTION = (0.1, -0.02, 0.001, 0.0, 0.0)


@pytest.mark.parametrize(
    "camera",
    [
        PLAIN,
        replace(PLAIN, distortion=DISTORTION, lens=Lens(310.0, 311.0, 318.0, 241.0, (), "plumb_bob")),
        replace(PLAIN, distortion=DISTORTION, lens=Lens(310.0, 311.0, 318.0, 241.0, TURN, "plumb_bob")),
        replace(PLAIN, lens=Lens(320.0, 321.0, 319.5, 239.5, TURN)),
        replace(PLAIN, lens=Lens(310.0, 311.0, 318.0, 241.0)),
    ],
    ids=["rectified", "distorted, no R", "distorted", "turned", "another K"],
)
def test_a_camera_comes_back_as_it_was(camera):
    assert camera_from_calibration(CameraCalibration.FromString(encode_calibration(1, camera))) == camera


def test_an_R_of_zeros_is_unknown():
    message = CameraCalibration.FromString(encode_calibration(1, replace(PLAIN, distortion=DISTORTION)))
    message.R.extend(np.zeros(9))
    assert camera_from_calibration(message).lens == Lens(320.0, 321.0, 319.5, 239.5, (), "plumb_bob")
    del message.D[:]
    assert is_rectified(camera_from_calibration(message))


def test_the_distortion_of_a_message_with_K_and_D_alone_can_be_undone():
    message = CameraCalibration.FromString(encode_calibration(1, replace(PLAIN, distortion=DISTORTION)))
    del message.R[:], message.P[:]
    camera = camera_from_calibration(message)
    assert lens_fault(camera) is None
    assert rectified(camera) == replace(PLAIN, baseline_m=None)


def changed(camera=PLAIN, **entries):
    """The message of a camera with single entries of its arrays set, such as ``K={0: 1.0}``."""
    message = CameraCalibration.FromString(encode_calibration(1, camera))
    for name, values in entries.items():
        for at, value in values.items():
            getattr(message, name)[at] = value
    return message


@pytest.mark.parametrize(
    ("entries", "fault"),
    [
        ({0: 1e-30}, "fx 1e-30: expected 0.64 to 640000 pixels for an image 640 pixels wide"),
        ({0: 1e30}, "fx 1e+30: expected 0.64 to 640000 pixels"),
        ({5: 0.1}, "fy 0.1: expected 0.64"),
        ({2: 1e30}, "cx 1e+30: expected at most 6400 pixels from 0 in an image of 640"),
        ({6: -5000.0}, "cy -5000: expected at most 4800 pixels from 0 in an image of 480"),
    ],
)
def test_impossible_intrinsics_are_refused(entries, fault):
    with pytest.raises(DecodeError, match=re.escape(f"calibration of 'right': {fault}")):
        camera_from_calibration(changed(P=entries))
    without_P = changed(K={{5: 4, 6: 5}.get(at, at): value for at, value in entries.items()})
    del without_P.P[:]
    with pytest.raises(DecodeError, match=re.escape(f"calibration of 'right': {fault}")):
        camera_from_calibration(without_P)


@pytest.mark.parametrize("K", [{0: np.nan}, {0: -1.0}, {0: 1e-30}, {4: 0.0}, {2: np.inf}, {5: np.nan}])
def test_an_impossible_lens_only_prevents_rectification(K):
    """P stays: the image is one of that camera, and who must rectify it says why that cannot be done."""
    camera = camera_from_calibration(changed(K=K))
    assert (camera.fx, camera.cy) == (PLAIN.fx, PLAIN.cy)
    assert lens_fault(camera)[0] == "lens_without_camera_matrix"


@pytest.mark.parametrize("entries", [{"D": {1: np.nan}}, {"R": {8: np.nan}}, {"K": {0: np.nan}}])
def test_equal_invalid_messages_give_equal_cameras(entries):
    lens = replace(PLAIN, distortion=DISTORTION, lens=Lens(310.0, 311.0, 318.0, 241.0, TURN, "plumb_bob"))
    first, second = (camera_from_calibration(changed(lens, **entries)) for _ in range(2))
    assert repr(first) == repr(second)
    assert first.distortion == second.distortion
    assert first.lens.R == second.lens.R
