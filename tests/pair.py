"""A road and the back of a car, photographed from anywhere through any lens, with exact depth."""

from dataclasses import replace

import cv2
import numpy as np

from roadperc_stream import geometry as g
from roadperc_stream.geometry.rotations import rotation_from_rpy

CAR_X_M, CAR_HALF_WIDTH_M, CAR_HEIGHT_M = 12.0, 1.0, 1.6
"""The car's back stands across the lane so far ahead of the ego origin."""
_PROJECTOR = g.Camera("projector", 1024, 1024, 400.0, 400.0, 512.0, 512.0)
_EGO_T_PROJECTOR = g.mounting(z=1.3)
"""The texture lies on road and car as a slide is projected on them: equally fine in the image wherever it is seen."""


def _slide():
    noise = np.random.default_rng(0).uniform(0, 255, (1024, 1024)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)


SLIDE = _slide()


def directions(camera):
    """(H, W, 3) rays with z = 1 of the pixels of the image as it is taken, through the camera's lens if it has one."""
    rows, columns = np.indices(camera.size, dtype=float)
    pixels = np.stack((columns, rows), axis=-1)
    if camera.lens is None:
        return g.rays(camera, pixels)
    straight = cv2.undistortPoints(pixels.reshape(-1, 1, 2), camera.lens.K, np.array(camera.distortion))
    return np.dstack((straight.reshape(*camera.size, 2), np.ones(camera.size)))


def scene(rays, ego_T_camera):
    """Of (H, W, 3) rays with z = 1: (H, W) depth, NaN in the sky; (H, W, 3) ego points; and where the car is."""
    turned, centre = rays @ ego_T_camera[:3, :3].T, ego_T_camera[:3, 3]
    with np.errstate(divide="ignore"):
        road = np.where(turned[..., 2] < 0, -centre[2] / turned[..., 2], np.inf)
        back = (CAR_X_M - centre[0]) / turned[..., 0]
    at_back = centre + turned * back[..., None]
    car = (np.abs(at_back[..., 1]) < CAR_HALF_WIDTH_M) & (at_back[..., 2] > 0) & (at_back[..., 2] < CAR_HEIGHT_M)
    depth = np.where(car, back, road)
    depth[~(depth < 200)] = np.nan
    return depth, centre + turned * depth[..., None], car


def photograph(camera, ego_T_camera):
    """(H, W) uint8."""
    _, points, _ = scene(directions(camera), ego_T_camera)
    pixels = g.project(_PROJECTOR, g.transform(g.inverse(_EGO_T_PROJECTOR), points)).astype(np.float32)
    grey = cv2.remap(SLIDE, *np.moveaxis(pixels, -1, 0), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.where(np.isfinite(pixels[..., 0]), grey, 255).astype(np.uint8)


def depth_of(camera, ego_T_camera):
    """(H, W) true metres along z of the camera without its lens, NaN in the sky."""
    return scene(directions(replace(camera, lens=None)), ego_T_camera)[0]


def crooked(camera, baseline_m, ego_T_rectified, degrees):
    """Left and right camera of a pair with their mountings, which are turned against the rectified pair's.

    Each is turned by so much about every axis, the other way than the other, and each has a lens of its own.
    """
    ego_T_aside = ego_T_rectified @ g.rigid(np.eye(3), np.array([baseline_m, 0.0, 0.0]))
    left, right = replace(camera, frame_id="left"), replace(camera, frame_id="right", baseline_m=baseline_m)
    return (
        _behind_a_lens(left, 1.03, (-0.1, 0.02, 0.001, 0.0), degrees, ego_T_rectified),
        _behind_a_lens(right, 1.01, (-0.08, 0.0, 0.0, 0.001), -degrees, ego_T_aside),
    )


def _behind_a_lens(camera, zoom, distortion, degrees, ego_T_rectified):
    angle = np.radians(degrees)
    R = rotation_from_rpy(angle, -angle, angle)
    lens = g.Lens(zoom * camera.fx, zoom * camera.fy, camera.cx - 4, camera.cy + 3, tuple(R.ravel()))
    return replace(camera, distortion=distortion, lens=lens), ego_T_rectified @ g.rigid(R, np.zeros(3))
