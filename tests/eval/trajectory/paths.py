"""Synthetic trajectories, and metrics tables with them."""

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

from roadperc_stream.eval.runs import written_columns
from tests.eval.tables import START_NS, STEP_NS


def poses_at(places, rotvecs=None):
    """(N, 4, 4) poses at (N, 3) positions; level and along x without rotation vectors."""
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, :3, 3] = places
    if rotvecs is not None:
        poses[:, :3, :3] = Rotation.from_rotvec(rotvecs).as_matrix()
    return poses


def helix(frames, radius_m=20.0, step_m=0.7, climb=0.05):
    """A climbing bend, driven forward."""
    yaw = np.arange(frames) * step_m / radius_m
    places = np.stack((radius_m * np.sin(yaw), radius_m * (1 - np.cos(yaw)), climb * radius_m * yaw), axis=1)
    return poses_at(places, np.stack((np.zeros(frames), np.zeros(frames), yaw), axis=1))


def straight(frames, step_m):
    return poses_at(np.outer(np.arange(frames), [step_m, 0.0, 0.0]))


def noisy(poses, seed, place_m=0.05, turn_rad=0.002):
    """The same path with an error in every step, as from drifting odometry."""
    rng = np.random.default_rng(seed)
    wrong = poses_at(rng.normal(0, place_m, (len(poses), 3)), rng.normal(0, turn_rad, (len(poses), 3)))
    found = [np.eye(4)]
    for before, now, off in zip(poses, poses[1:], wrong, strict=False):
        found.append(found[-1] @ np.linalg.inv(before) @ now @ off)
    return np.array(found)


def rigid(seed):
    rng = np.random.default_rng(seed)
    return poses_at(rng.normal(0, 10, (1, 3)), rng.normal(0, 1, (1, 3)))[0]


def scaled(poses, scale):
    result = poses.copy()
    result[:, :3, 3] *= scale
    return result


def columns(prefix, poses):
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    names = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
    return {
        f"{prefix}_{name}": values for name, values in zip(names, [*poses[:, :3, 3].T, *quaternions.T], strict=True)
    }


def write_run(path, estimated, true=None, **others):
    """A metrics table with estimated poses, true poses if any, and other columns."""
    frames = len(estimated)
    steps_m = np.linalg.norm(np.diff(estimated[:, :3, 3], axis=0), axis=1).tolist()
    table = {
        "log_id": ["a" * 16] * frames,
        "frame": range(frames),
        "stamp_ns": [START_NS + k * STEP_NS + 123_456_789 for k in range(frames)],
        "segment": [0] * frames,
        "missing": [[]] * frames,
        "reasons": [[]] * frames,
        "total_ms": [10.0] * frames,
        "odometry_status": ["first"] + ["tracked"] * (frames - 1),
        "step_m": [None, *steps_m],
        "turn_deg": [None] + [0.1] * (frames - 1),
        **columns("odom", estimated),
        **(columns("true", true) if true is not None else {}),
        **others,
    }
    found = pl.DataFrame(table, strict=False)
    others = [pl.lit(None, kind).alias(name) for name, kind in written_columns().items() if name not in table]
    found.with_columns(others).write_parquet(path)
    return path
