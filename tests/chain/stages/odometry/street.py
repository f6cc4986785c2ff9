"""Images and exact depth of a street of four textured planes, from any pose."""

from dataclasses import dataclass

import cv2
import numpy as np

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages.odometry import ego_motion
from roadperc_stream.chain.stages.odometry.keyframes import OdometryState
from roadperc_stream.config import OdometryConfig
from roadperc_stream.geometry.rotations import rotation_from_rpy
from tests.analytic import VEHICLE
from tests.scenes import scene_of

CFG = OdometryConfig(min_rows=240)
CAMERA = g.Camera("front", 640, 480, 320.0, 320.0, 319.5, 239.5)
EGO_T_CAMERA = g.rigid(g.EGO_R_OPTICAL, np.array([1.5, 0.0, 1.4]))
STEP_NS = 50_000_000
PLANES = tuple(
    g.Plane.of(np.array(normal, float), offset)
    for normal, offset in (((0, 0, 1), 0.0), ((0, -1, 0), 7.0), ((0, 1, 0), 6.0), ((-1, 0, 0), 45.0))
)
GRAIN_M = 0.05


@dataclass(frozen=True)
class Shot:
    grey: np.ndarray
    depth_m: np.ndarray


def texture(seed):
    rng = np.random.default_rng(seed)
    size = 1024
    total = sum(
        cv2.resize(rng.normal(0, 1, (size // n, size // n)).astype(np.float32), (size, size), interpolation=3)
        for n in (2, 4, 8, 32)
    )
    return np.clip(128 + 30 * total, 0, 255).astype(np.float32)


TEXTURES = tuple(texture(seed) for seed in range(len(PLANES)))


def photograph(odom_T_ego, camera=CAMERA, ego_T_camera=EGO_T_CAMERA, textures=TEXTURES):
    rows, columns = np.indices(camera.size, dtype=float)
    pixels = np.stack((columns, rows), axis=-1)
    odom_T_camera = odom_T_ego @ ego_T_camera
    nearest, grey = np.full(camera.size, np.inf), np.zeros(camera.size, np.float32)
    for plane, pattern in zip(PLANES, textures, strict=True):
        visible = g.intersect_plane(camera, pixels, g.transform_plane(g.inverse(odom_T_camera), plane))
        points = g.transform(odom_T_camera, visible) / GRAIN_M
        axes = [k for k in range(3) if abs(plane.normal[k]) < 0.5]
        u, v = (np.nan_to_num(points[..., k]).astype(np.float32) for k in axes)
        colours = cv2.remap(pattern, u % 1023, v % 1023, cv2.INTER_LINEAR)
        closer = visible[..., 2] < nearest
        nearest, grey = np.where(closer, visible[..., 2], nearest), np.where(closer, colours, grey)
    return Shot(np.rint(grey).astype(np.uint8), nearest.astype(np.float32))


def pose(x, y=0.0, yaw=0.0, pitch=0.0):
    return g.rigid(rotation_from_rpy(0.0, pitch, yaw), np.array([x, y, 0.0]))


def drive(count, step_m=0.4, turn=0.01):
    """Poses in a bend; the first is the identity."""
    poses = [np.eye(4)]
    for _ in range(count - 1):
        poses.append(poses[-1] @ pose(step_m, yaw=turn))
    return poses


def run(shots, cfg=CFG, state=None, first=0, depth=True, movable=None, road=None):
    """The states and results of shots; None is a missing frame. ``movable`` (H, W) marks pixels of vehicles."""
    tags = None if movable is None else np.where(movable, VEHICLE, 0).astype(np.uint8)
    state, states, results = state or OdometryState(), [], []
    for k, shot in enumerate(shots, first):
        scene = scene_of(
            CAMERA,
            EGO_T_CAMERA,
            grey=shot and shot.grey,
            depth_m=shot.depth_m if shot and depth else None,
            tags=tags,
            stamp_ns=1_000_000_000 + k * STEP_NS,
        )
        state, out = ego_motion.step(cfg, state, scene, road, np.random.default_rng((0, k)))
        states.append(state)
        results.append(out)
    return states, results
