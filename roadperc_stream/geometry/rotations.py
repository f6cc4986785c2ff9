"""Rigid transforms and rotations: pure functions on arrays.

Names follow ``a_T_b``: a (4, 4) matrix that maps coordinates in frame b to frame a. Ego and odom are x forward, y left,
z up.

Formulas and results of rotations are those of scipy's ``Rotation``. Its import takes half a second, and its checks take
longer than the formulas. Quaternions are x, y, z, w (ROS).
"""

import math
from typing import Final

import numpy as np

from roadperc_stream.geometry.arrays import Float

EGO_R_OPTICAL: Final[Float] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation of a camera that looks along ego's x axis, level."""
Quaternion = tuple[float, float, float, float]
_SMALL_ANGLE: Final = 1e-3
"""Radians up to which a series is more accurate than a quotient of two small numbers."""
_IDENTITY: Final[Float] = np.eye(4)
_ORTHOGONAL: Final = 1e-12 + 1e-5 * _IDENTITY[:3, :3]
"""Deviation of R R^T from the identity up to which a matrix counts as a rotation."""


def rigid(rotation: Float, translation: Float) -> Float:
    """(4, 4) transform from a (3, 3) rotation and a (3,) translation in metres."""
    T = _IDENTITY.copy()
    T[:3, :3], T[:3, 3] = rotation, translation
    return T


def is_rotation(matrix: Float, tolerance: float = 5e-3) -> bool:
    """Whether a (3, 3) matrix is a rotation, up to rounding: no mirror, no scale."""
    near = np.abs(matrix).max() <= 2 and np.allclose(matrix @ matrix.T, np.eye(3), atol=tolerance)
    return bool(near and np.linalg.det(matrix) > 0)


def inverse(a_T_b: Float) -> Float:
    """b_T_a of a rigid transform."""
    R = a_T_b[:3, :3].T
    return rigid(R, -R @ a_T_b[:3, 3])


def adjoint(a_T_b: Float) -> Float:
    """(6, 6) matrix that brings a small translation and rotation, fixed to a body, from frame b's axes to frame a's.

    Source: Murray, Li and Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, section 2.4.2.
    """
    R, lever = a_T_b[:3, :3], a_T_b[:3, 3]
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = R
    result[:3, 3:] = np.cross(lever, R, axisb=0, axisc=0)
    return result


def transform(a_T_b: Float, points_b: Float) -> Float:
    """(..., 3) points in frame a."""
    result: Float = points_b @ a_T_b[:3, :3].T + a_T_b[:3, 3]
    return result


def mounting(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0
) -> Float:
    """The mounting ``ego_T_camera`` of a camera that looks ahead; angles of 0 are a level camera.

    The rotations are those of ROS REP 103 in the ego frame: first roll, then pitch, then yaw.

    Args:
        x: metres from the ego origin to the camera, positive forward.
        y: metres, positive to the left.
        z: metres, positive up; the height above the road if the ego origin is on the road.
        roll: degrees about the forward axis, positive if the right side is down.
        pitch: degrees, positive if the camera looks down.
        yaw: degrees, positive if the camera looks to the left.

    Returns:
        (4, 4) matrix that maps points in the camera's frame (x right, y down, z forward) to the ego frame.

    Raises:
        ValueError: a number is not finite.
    """
    numbers = (x, y, z, roll, pitch, yaw)
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"mounting: expected finite numbers, found {numbers}")
    R = rotation_from_rpy(math.radians(roll), math.radians(pitch), math.radians(yaw))
    return rigid(R @ EGO_R_OPTICAL, np.array([x, y, z], np.float64))


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> Float:
    """(3, 3) rotation Rz(yaw) Ry(pitch) Rx(roll), radians, as in ROS REP 103 (pitch: nose down positive)."""
    about_z = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    about_y = (0.0, math.sin(pitch / 2), 0.0, math.cos(pitch / 2))
    about_x = (math.sin(roll / 2), 0.0, 0.0, math.cos(roll / 2))
    return _matrix(_product(_product(about_z, about_y), about_x))


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> Float:
    """(3, 3) rotation of a quaternion of any length above zero.

    Raises:
        ValueError: all four numbers are zero, or one is not finite.
    """
    largest = max(abs(number) for number in (x, y, z, w))
    if not 0 < largest < math.inf or not all(map(math.isfinite, (x, y, z, w))):
        raise ValueError(f"quaternion ({x:g}, {y:g}, {z:g}, {w:g}): expected finite numbers that are not all zero")
    # Scaling by a power of two is exact and keeps the squares within a float's range.
    x, y, z, w = (math.ldexp(number, -math.frexp(largest)[1]) for number in (x, y, z, w))
    return _matrix(_normalised((x, y, z, w)))


def rotations_from_quaternions(quaternions: Float) -> Float:
    """(N, 3, 3) rotations of (N, 4) finite quaternions x, y, z, w, of lengths from 1e-150 to 1e150."""
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.moveaxis(_matrix(unit.T), -1, 0)


def rotation_from_vector(vector: Float) -> Float:
    """(3, 3) rotation about a (3,) axis by its length, radians."""
    x, y, z = vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    half = 0.5 - angle**2 / 48 + angle**4 / 3840 if angle <= _SMALL_ANGLE else math.sin(angle / 2) / angle
    return _matrix((half * x, half * y, half * z, math.cos(angle / 2)))


def quaternion(rotation: Float) -> Quaternion:
    """x, y, z, w with w >= 0 of a (3, 3) rotation, or of the nearest rotation to another matrix.

    Source: Markley, "Unit Quaternion from Rotation Matrix", Journal of Guidance, Control, and Dynamics 31, 2008.
    """
    if not (np.abs(rotation @ rotation.T - _IDENTITY[:3, :3]) <= _ORTHOGONAL).all():
        U, _, Vt = np.linalg.svd(rotation)
        rotation = U @ Vt
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    trace = a + e + i
    largest = max(a, e, i, trace)
    if largest == a:
        found = (1 - trace + 2 * a, d + b, g + c, h - f)
    elif largest == e:
        found = (d + b, 1 - trace + 2 * e, h + f, c - g)
    elif largest == i:
        found = (g + c, h + f, 1 - trace + 2 * i, d - b)
    else:
        found = (h - f, c - g, d - b, 1 + trace)
    return _canonical(_normalised(found))


def rotation_vector(rotation: Float) -> Float:
    """(3,) axis of a (3, 3) rotation, scaled to the angle in radians."""
    x, y, z, w = quaternion(rotation)
    angle = 2 * math.atan2(math.sqrt(x * x + y * y + z * z), w)
    small = angle <= _SMALL_ANGLE
    length = 2 + angle**2 / 12 + 7 * angle**4 / 2880 if small else angle / math.sin(angle / 2)
    return np.array((length * x, length * y, length * z))


def rotation_angle(rotation: Float) -> float:
    """Angle of a (3, 3) rotation, radians; accurate for small ones."""
    x, y, z, w = quaternion(rotation)
    return 2 * math.atan2(math.sqrt(x * x + y * y + z * z), w)


def _normalised(quaternion: Quaternion) -> Quaternion:
    x, y, z, w = quaternion
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return x / length, y / length, z / length, w / length


def _canonical(quaternion: Quaternion) -> Quaternion:
    """The equal rotation's quaternion with positive w; if w is 0, its first number that is not 0 is positive."""
    x, y, z, w = quaternion
    if next((number for number in (w, x, y, z) if number != 0), 0.0) < 0:
        return -x, -y, -z, -w
    return quaternion


def _product(p: Quaternion, q: Quaternion) -> Quaternion:
    """The rotation by q, then by p."""
    return (
        p[3] * q[0] + q[3] * p[0] + (p[1] * q[2] - p[2] * q[1]),
        p[3] * q[1] + q[3] * p[1] + (p[2] * q[0] - p[0] * q[2]),
        p[3] * q[2] + q[3] * p[2] + (p[0] * q[1] - p[1] * q[0]),
        p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2],
    )


def _matrix(quaternion: Quaternion | Float) -> Float:
    """(3, 3) rotation of a quaternion of unit length, or (3, 3, N) rotations of (4, N) ones."""
    x, y, z, w = quaternion
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    return np.array(
        (
            (xx - yy - zz + ww, 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), -xx + yy - zz + ww, 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), -xx - yy + zz + ww),
        )
    )
