"""Errors of a trajectory against the true one; both are (N, 4, 4) poses odom_T_ego."""

import numpy as np
from scipy.spatial.transform import Rotation

from roadperc_stream.geometry import inverse


def distances_m(poses):
    """(N,) metres driven up to each pose."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1))))


def angle_deg(rotation):
    return float(np.rad2deg(np.linalg.norm(Rotation.from_matrix(rotation).as_rotvec())))


def relative_errors(estimated, true, lengths_m, every=5):
    """Mean translation error per distance, and rotation error in degrees per 100 m, over stretches of given lengths.

    Source: KITTI's odometry benchmark (Geiger, Lenz and Urtasun 2012).
    """
    driven = distances_m(true)
    shift, turn = [], []
    for length_m in lengths_m:
        for i in range(0, len(true), every):
            j = int(np.searchsorted(driven, driven[i] + length_m))
            if j < len(true):
                error = inverse(inverse(true[i]) @ true[j]) @ inverse(estimated[i]) @ estimated[j]
                shift.append(np.linalg.norm(error[:3, 3]) / length_m)
                turn.append(100 * angle_deg(error[:3, :3]) / length_m)
    return float(np.mean(shift)), float(np.mean(turn))


def aligned_errors_m(estimated, true):
    """(N,) distances after the best similarity transform (Umeyama 1991)."""
    a, b = estimated[:, :3, 3], true[:, :3, 3]
    A, B = a - a.mean(axis=0), b - b.mean(axis=0)
    U, S, Vt = np.linalg.svd(B.T @ A / len(a))
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    scale = np.trace(np.diag(S) @ D) / np.mean(np.sum(A**2, axis=1))
    return np.linalg.norm(scale * A @ (U @ D @ Vt).T - B, axis=1)
