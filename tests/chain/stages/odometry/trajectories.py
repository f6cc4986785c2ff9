"""Errors of a trajectory against the true one; both are (N, 4, 4) poses odom_T_ego."""

import numpy as np

from roadperc_stream.eval.trajectory.errors import absolute_errors_m, align, angles_deg, segment_errors
from roadperc_stream.eval.trajectory.errors import path_m as distances_m

__all__ = ["aligned_errors_m", "angle_deg", "distances_m", "relative_errors"]


def angle_deg(rotation):
    return float(angles_deg(rotation[None])[0])


def relative_errors(estimated, true, lengths_m, every=5):
    """Mean translation error per distance, and rotation error in degrees per 100 m, over stretches of given lengths."""
    found = [segment_errors(estimated, true, length_m, every) for length_m in lengths_m]
    percent, deg_per_100m = (np.concatenate(part) for part in zip(*found, strict=True))
    return float(np.mean(percent)) / 100, float(np.mean(deg_per_100m))


def aligned_errors_m(estimated, true):
    """(N,) distances after the best similarity transform."""
    return absolute_errors_m(align(estimated, true, "sim3").poses(estimated), true)
