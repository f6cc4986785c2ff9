"""The evidence of one frame for the findings of a replay: facts that no column of its row holds."""

from typing import Final

import numpy as np

from roadperc_stream.chain.pixels import needs_scene
from roadperc_stream.chain.stages.stereo import disparities_needed
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Camera, Float, Float32, inverse, rays
from roadperc_stream.geometry.planes import Plane, transform_plane
from roadperc_stream.model import Absent, Frame, FrameResult, StereoDepth
from roadperc_stream.model.finding import Evidence
from roadperc_stream.model.reason import UNUSABLE

_MOST_PAIRS: Final = 128
"""Rows and columns of a depth image from which neighbours are compared."""
_ROUGH_M, _ROUGH_SHARE = 1.0, 0.25
"""Difference of neighbours that is rough: in metres, and as a share of the smaller depth. A road near the horizon
differs by metres, but in few rows."""
_FEWEST_PAIRS: Final = 0.05
"""Share of the compared pairs that must differ, and so show whether the depth is rough."""
_ROAD_ROWS: Final = 0.6
"""Share of the image above the pixels that see the road."""
_ROAD_GRID: Final = (16, 32)
_FAR_M: Final = 60.0
"""Depth of the ground up to which its pixels count."""


def evidence_of(cfg: ReplayConfig, frame: Frame, result: FrameResult) -> Evidence:
    """The evidence of one frame; what its stages did not decode is not decoded for it."""
    sensor_m = _sensor_depth_m(cfg, frame)
    stereo, baseline_m = result.stereo, frame.right_camera.baseline_m if frame.right_camera else None
    matched = stereo if isinstance(stereo, StereoDepth) else None
    places = {
        frame.camera.frame_id: frame.ego_T_camera,
        frame.left_camera.frame_id: frame.ego_T_left,
        frame.depth_camera.frame_id: frame.ego_T_depth_camera,
    }
    ego_T_surface = None if isinstance(result.surface, Absent) else places.get(result.surface.frame_id)
    mounted = frame.mounted and ego_T_surface is not None
    known = ratio = searched = None
    if matched is not None and baseline_m:
        searched = searched_ratio(cfg, frame.left_camera, frame.ego_T_left, baseline_m)
    if sensor_m is not None:
        known, ratio = road_depth(frame.depth_camera, frame.ego_T_depth_camera, sensor_m)
    elif matched is not None:
        known, ratio = road_depth(frame.left_camera, frame.ego_T_left, matched.depth_m)
    return Evidence(
        mounting_m=float(ego_T_surface[2, 3]) if mounted and ego_T_surface is not None else None,
        rough_ratio=None if sensor_m is None else rough_ratio(sensor_m),
        road_known_ratio=known,
        road_depth_ratio=ratio,
        searched_ratio=searched,
        baseline_m=baseline_m if searched is not None else None,
        unusable=tuple(str(reason) for reason in result.reasons() if reason.code in UNUSABLE),
    )


def _sensor_depth_m(cfg: ReplayConfig, frame: Frame) -> Float32 | None:
    """The depth image, if the chain has decoded it and it has the size of its camera."""
    if frame.depth is None or not needs_scene(cfg):
        return None
    try:
        depth_m = frame.depth.depth_m
    except DecodeError:
        return None
    return depth_m if depth_m.shape == frame.depth_camera.size else None


def rough_ratio(depth_m: Float32) -> float | None:
    """Share of neighbouring pixels that differ by metres among those that differ at all.

    In depth read with the wrong byte order neighbours are unrelated. In depth of a scene only the borders of objects
    and the horizon are rough.

    Args:
        depth_m: (H, W) metres, NaN or 0 unknown.

    Returns:
        0 to 1; None if few neighbours are known and differ.
    """
    rows, columns = (slice(None, -1, max(1, size // _MOST_PAIRS)) for size in depth_m.shape)
    below, beside = depth_m[1:][rows.start : None : rows.step], depth_m[:, 1:][:, columns.start : None : columns.step]
    here = depth_m[rows, columns]
    pairs = ((here, below[:, columns]), (here, beside[rows]))
    differing, rough, compared = 0, 0, 0
    for first, second in pairs:
        known = (first > 0) & (second > 0)
        difference, least = np.abs(first - second)[known], np.minimum(first, second)[known]
        compared += first.size
        differing += int(np.count_nonzero(difference > 0))
        rough += int(np.count_nonzero((difference > _ROUGH_M) & (difference > _ROUGH_SHARE * least)))
    return rough / differing if differing > _FEWEST_PAIRS * compared else None


def road_depth(camera: Camera, ego_T_camera: Float, depth_m: Float32) -> tuple[float | None, float | None]:
    """Share of the road's pixels with a depth, and the median of their depth / the ground's; None if unknown."""
    pixels, ground_m = _ground(camera, ego_T_camera)
    if not len(ground_m):
        return None, None
    columns, rows = pixels.astype(int).T
    found_m = depth_m[rows, columns]
    known = found_m > 0
    ratio = float(np.median(found_m[known] / ground_m[known])) if known.any() else None
    return float(np.mean(known)), ratio


def searched_ratio(cfg: ReplayConfig, left: Camera, ego_T_left: Float, baseline_m: float) -> float | None:
    """Share of the road's pixels whose disparity is among those that stereo searches; None if unknown."""
    asked = cfg.stereo.disparities
    count = disparities_needed(left, baseline_m, ego_T_left) if asked == "auto" else asked
    _, ground_m = _ground(left, ego_T_left)
    if count is None or not len(ground_m):
        return None
    disparity_px = left.fx * baseline_m / ground_m
    return float(np.mean((disparity_px >= cfg.stereo.min_disparity_px) & (disparity_px <= count)))


def _ground(camera: Camera, ego_T_camera: Float) -> tuple[Float, Float]:
    """(N, 2) pixels of the lower image that see the level ground, and its (N,) depth in metres."""
    rows = np.linspace(_ROAD_ROWS * camera.height, camera.height - 1, _ROAD_GRID[0]).round()
    columns = np.linspace(0, camera.width - 1, _ROAD_GRID[1]).round()
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    road = transform_plane(inverse(ego_T_camera), Plane.of(np.array([0.0, 0.0, 1.0]), 0.0))
    slope = -rays(camera, pixels) @ road.n
    ahead = slope * _FAR_M > max(road.offset_m, 0.0) if road.offset_m > 0 else np.zeros(len(pixels), bool)
    return pixels[ahead], road.offset_m / slope[ahead]
