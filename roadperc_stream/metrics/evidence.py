"""The evidence of one frame for the findings of a replay: facts that no column of its row holds."""

from math import degrees
from typing import Final

import numpy as np

from roadperc_stream.chain.stages.stereo import disparities_needed
from roadperc_stream.config import ReplayConfig
from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.geometry.planes import angle_between
from roadperc_stream.model import Absent, Frame, FrameResult, StereoDepth, Surface
from roadperc_stream.model.finding import Evidence

_COMPARED: Final = 64
"""Rows or columns of a depth image from which neighbours are compared."""
_ROUGH_M, _ROUGH_SHARE = 1.0, 0.25
"""Rough difference of neighbours: in metres, and as a share of the smaller depth. The road near the horizon differs by
metres, but in few rows by this share."""
_FEWEST_DIFFER: Final = 0.02
"""Share of the neighbours that must differ, and so show whether the depth is rough. Millimetres in 16 bits end at
65.535 m; most of a depth in the wrong byte order is beyond."""
_ROAD_ROWS: Final = 0.6
"""Share of the image above the pixels that see the road."""
_ROAD_GRID: Final = (16, 32)
_FAR_M: Final = 60.0
"""Depth of the ground up to which its pixels count."""


def evidence_of(cfg: ReplayConfig, frame: Frame, result: FrameResult) -> Evidence:
    """The evidence of one frame; what its stages did not decode is not decoded for it."""
    sensor_m = frame.raw_depth_m if frame.depth_source == "depth" else None
    places = {
        frame.camera.frame_id: frame.ego_T_camera,
        frame.left_camera.frame_id: frame.ego_T_left,
        frame.depth_camera.frame_id: frame.ego_T_depth_camera,
    }
    ego_T_surface = None if isinstance(result.surface, Absent) else places.get(result.surface.frame_id)
    road: tuple[float | None, float | None] = None, None
    if sensor_m is not None and cfg.surface.enabled:
        road = road_depth(frame.depth_camera, frame.ego_T_depth_camera, sensor_m)
    elif isinstance(result.stereo, StereoDepth) and cfg.surface.enabled:
        searched_m = searched_depths(cfg, frame)
        road = road_depth(frame.left_camera, frame.ego_T_left, result.stereo.depth_m, searched_m)
    return Evidence(
        mounting_m=float(ego_T_surface[2, 3]) if frame.mounted and ego_T_surface is not None else None,
        rough_ratio=None if sensor_m is None else rough_ratio(sensor_m),
        road_known_ratio=road[0],
        road_depth_ratio=road[1],
        pitch_deg=_pitch_deg(frame, result.front_surface),
    )


def _pitch_deg(frame: Frame, road: Surface | Absent) -> float | None:
    """Angle between an estimated road and that of the mounting, degrees; None if the road has another source."""
    if isinstance(road, Absent) or road.source != "estimated":
        return None
    return degrees(angle_between(frame.ego_T_camera[:3, :3] @ road.plane.n, np.array([0.0, 0.0, 1.0])))


def rough_ratio(depth_m: Float32) -> float | None:
    """Share of neighbouring pixels that differ by metres among those that differ at all.

    In depth read with the wrong byte order neighbours are unrelated. In depth of a scene only the borders of objects
    and the horizon are rough.

    Args:
        depth_m: (H, W) metres, NaN or 0 unknown.

    Returns:
        0 to 1; None if few neighbours are known and differ.
    """
    step = max(1, min(depth_m.shape) // _COMPARED)
    here = depth_m[:-1:step, :-1:step]
    beside = np.stack([depth_m[1::step, :-1:step], depth_m[:-1:step, 1::step]])
    with np.errstate(invalid="ignore"):
        difference, least = np.abs(here - beside), np.minimum(here, beside)
        differ = (least > 0) & (difference > 0)
        rough = differ & (difference > _ROUGH_M) & (difference > _ROUGH_SHARE * least)
    count = int(np.count_nonzero(differ))
    return int(np.count_nonzero(rough)) / count if count > _FEWEST_DIFFER * differ.size else None


def searched_depths(cfg: ReplayConfig, frame: Frame) -> tuple[float, float]:
    """Nearest and farthest depth whose disparities stereo searches, metres; both 0 without a baseline."""
    left, asked = frame.left_camera, cfg.stereo.disparities
    baseline_m = frame.right_camera.baseline_m if frame.right_camera else None
    if not baseline_m:
        return 0.0, 0.0
    count = (disparities_needed(left, baseline_m, frame.ego_T_left) or 1) if asked == "auto" else asked
    return left.fx * baseline_m / count, left.fx * baseline_m / cfg.stereo.min_disparity_px


def road_depth(
    camera: Camera, ego_T_camera: Float, depth_m: Float32, searched_m: tuple[float, float] = (0.0, np.inf)
) -> tuple[float | None, float | None]:
    """Share of the road's pixels with a depth, and the median of their depth / the ground's; None if unknown.

    The road's pixels are those of the lower image that see the level ground. Pixels whose ground is outside
    ``searched_m`` cannot get a depth by stereo, and count as unknown.
    """
    rows = np.linspace(_ROAD_ROWS * camera.height, camera.height - 1, _ROAD_GRID[0]).astype(int)
    columns = np.linspace(0, camera.width - 1, _ROAD_GRID[1]).astype(int)
    x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    (to_x, to_y, to_z), height_m = ego_T_camera[2, :3].tolist(), float(ego_T_camera[2, 3])
    sinking = -to_x * x - (to_y * y + to_z)[:, None]  # the height that a ray loses for each metre of depth
    ahead = sinking > max(height_m, 0.0) / _FAR_M
    if height_m <= 0 or not ahead.any():
        return None, None
    ground_m, found_m = height_m / sinking[ahead], depth_m[rows][:, columns][ahead]
    known = (found_m > 0) & (ground_m >= searched_m[0]) & (ground_m <= searched_m[1])
    ratio = float(np.median(found_m[known] / ground_m[known])) if known.any() else None
    return np.count_nonzero(known) / len(known), ratio
