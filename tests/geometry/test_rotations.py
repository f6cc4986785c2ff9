"""Known answers and properties of rotations, against scipy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from roadperc_stream.geometry import rotations

ANGLES = st.floats(-3.0, 3.0)
SMALL = st.floats(-1e-3, 1e-3)
VECTORS = st.one_of(st.tuples(ANGLES, ANGLES, ANGLES), st.tuples(SMALL, SMALL, SMALL))
QUATERNIONS = st.tuples(ANGLES, ANGLES, ANGLES, ANGLES).filter(lambda numbers: np.linalg.norm(numbers) > 1e-3)
EXACT = 1e-14
"""A few units in the last place: another libm may round a sine differently."""


@given(ANGLES, ANGLES, ANGLES)
def test_roll_pitch_and_yaw_are_scipys(roll, pitch, yaw):
    expected = Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_matrix()
    np.testing.assert_allclose(rotations.rotation_from_rpy(roll, pitch, yaw), expected, atol=EXACT)


@given(VECTORS)
def test_vectors_matrices_quaternions_and_angles_are_scipys(vector):
    expected = Rotation.from_rotvec(vector)
    R = rotations.rotation_from_vector(np.array(vector))
    np.testing.assert_allclose(R, expected.as_matrix(), atol=EXACT)
    again = Rotation.from_matrix(R)
    np.testing.assert_allclose(rotations.rotation_vector(R), again.as_rotvec(), atol=EXACT)
    np.testing.assert_allclose(rotations.quaternion(R), again.as_quat(canonical=True), atol=EXACT)
    assert rotations.rotation_angle(R) == pytest.approx(again.magnitude(), abs=EXACT)


@given(QUATERNIONS)
def test_a_quaternion_comes_back_from_its_matrix(numbers):
    R = rotations.rotation_from_quaternion(*numbers)
    np.testing.assert_allclose(R, Rotation.from_quat(numbers).as_matrix(), atol=EXACT)
    assert rotations.rotation_from_quaternion(*rotations.quaternion(R)) == pytest.approx(R, abs=1e-9)


@pytest.mark.parametrize(
    "turn", [(np.pi, 0.0, 0.0), (0.0, np.pi, 0.0), (0.0, 0.0, np.pi), (0.0, -np.pi, 0.0), (0.0, 0.0, 0.0)]
)
def test_half_a_turn_has_a_quaternion(turn):
    found = rotations.quaternion(rotations.rotation_from_vector(np.array(turn)))
    np.testing.assert_allclose(np.abs(found), [*np.abs(np.array(turn)) / np.pi, float(not any(turn))], atol=1e-9)
    assert found[3] >= 0


def test_a_matrix_near_a_rotation_has_the_nearest_rotations_quaternion():
    R = rotations.rotation_from_rpy(0.1, -0.2, 0.3)
    for off in (1e-9, 1e-4):
        skewed = R @ (np.eye(3) + off * np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
        expected = Rotation.from_matrix(skewed).as_quat(canonical=True)
        np.testing.assert_allclose(rotations.quaternion(skewed), expected, atol=EXACT)


@pytest.mark.parametrize("numbers", [(0, 0, 0, 0), (np.nan, 0, 0, 1), (0, 1, np.inf, 0), (np.nan, 0, 0, 0)])
def test_zero_and_infinite_quaternions_are_refused(numbers):
    with pytest.raises(ValueError, match="expected finite numbers that are not all zero"):
        rotations.rotation_from_quaternion(*map(float, numbers))


@pytest.mark.parametrize("scale", [1e-300, 1e300])
def test_a_quaternion_of_any_length_is_scaled(scale):
    R = rotations.rotation_from_quaternion(0.1 * scale, -0.2 * scale, 0.3 * scale, 0.9 * scale)
    np.testing.assert_allclose(R, rotations.rotation_from_quaternion(0.1, -0.2, 0.3, 0.9), atol=1e-15)


@given(st.lists(QUATERNIONS, min_size=1, max_size=3))
def test_a_stack_of_quaternions_has_the_rotations_of_each(several):
    expected = [rotations.rotation_from_quaternion(*numbers) for numbers in several]
    np.testing.assert_allclose(rotations.rotations_from_quaternions(np.array(several)), expected, atol=EXACT)
