"""Both boundaries of the ego lane as one frame alone shows them."""

from dataclasses import dataclass, field

import numpy as np

from roadperc_stream.config import LanesConfig
from roadperc_stream.datatypes import Image, Mask, Side, Surface
from roadperc_stream.geometry import Camera, Float, intersect_plane, inverse, project, transform
from roadperc_stream.semantics import TagTable
from roadperc_stream.stages.lanes import lines
from roadperc_stream.stages.lanes.curves import Curve, facing_edges, fit_curve, lateral, line_on_ground
from roadperc_stream.stages.lanes.lines import LineGroup

_INSIDE_M = (0.2, 0.4, 0.6)
_OUTSIDE_M = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Distances beside a boundary at which the class there is looked up; a double marking is 0.35 m wide."""
_CLASS_AHEAD_M = np.arange(4.0, 14.0, 0.5)


@dataclass(frozen=True)
class View:
    """The road as the camera sees it: what turns pixels into places and back."""

    camera: Camera
    ego_T_camera: Float
    surface: Surface

    def ground(self, pixels: Float) -> Float:
        """(N, 3) ego points on the road of (N, 2) pixels, NaN above the horizon."""
        return transform(self.ego_T_camera, intersect_plane(self.camera, pixels, self.surface.plane))

    def on_road(self, x: Float, y: Float) -> Float:
        """(N, 3) ego points on the road at (N,) x and y."""
        a, b, d = self.surface.abd
        return np.stack((x, y, d - a * x - b * y), axis=-1)

    def pixels(self, points: Float) -> Float:
        """(N, 2) pixels of (N, 3) ego points, NaN behind the camera."""
        return project(self.camera, transform(inverse(self.ego_T_camera), points))

    def path_column(self) -> float:
        """Column where the car's path, ego y = 0, meets the image's bottom edge."""
        row = float(self.camera.height)
        (_, y0, _), (_, y1, _) = self.ground(np.array([[0.0, row], [float(self.camera.width), row]]))
        return float(y0 / (y0 - y1) * self.camera.width)


@dataclass(frozen=True)
class Sighting:
    """One boundary: its merged Hough line, its curve on the road where one fits, and the classes beside it."""

    group: LineGroup
    curve: Curve | None
    inside: str = ""
    outside: str = ""


@dataclass(frozen=True)
class Observation:
    """Everything one frame shows of the lane; ``far`` is the row of the road's far end."""

    far: float
    proposals: Float = field(default_factory=lambda: np.empty((0, 4)))
    groups: tuple[LineGroup, ...] = ()
    sightings: dict[Side, Sighting] = field(default_factory=dict)


def observe(cfg: LanesConfig, view: View, tags: Image, table: TagTable, road: Mask) -> Observation:
    """Find the ego lane's boundaries in one frame.

    Args:
        cfg: thresholds.
        view: camera and road.
        tags: (H, W) tags of ``table``.
        table: the tags' table.
        road: (H, W) drivable surface.
    """
    far = lines.road_far_end(road)
    if far is None:
        return Observation(float(view.camera.cy))
    marked = table.lookup(cfg.separators)
    proposals = lines.propose(cfg, lines.separator_mask(cfg, marked, tags), road)
    groups = lines.merge(cfg, proposals, view.camera.height)
    chosen = _ego_lane(cfg, view, groups)
    sightings = {side: _sight(cfg, view, side, group, tags, table, road, far) for side, group in chosen.items()}
    return Observation(float(far), proposals, groups, sightings)


def _ego_lane(cfg: LanesConfig, view: View, groups: tuple[LineGroup, ...]) -> dict[Side, LineGroup]:
    """The closest line on each side of the car's path at the image's bottom, among those with near support.

    A short fragment far away otherwise extrapolates to the closest place.
    """
    bottom, path = float(view.camera.height), view.path_column()
    near = [group for group in groups if _nearest_x(view, group) <= cfg.near_m]
    left = [group for group in near if group.x(bottom) < path and group.slope < 0]
    right = [group for group in near if group.x(bottom) >= path and group.slope > 0]
    chosen: dict[Side, LineGroup] = {}
    if left:
        chosen["left"] = max(left, key=lambda group: group.x(bottom))
    if right:
        chosen["right"] = min(right, key=lambda group: group.x(bottom))
    return chosen


def _nearest_x(view: View, group: LineGroup) -> float:
    """Ego x in metres of the line's lowest supported point; infinite above the horizon."""
    x = view.ground(np.array([[group.x(group.bottom_px), group.bottom_px]]))[0, 0]
    return float(x) if np.isfinite(x) else np.inf


def _sight(
    cfg: LanesConfig,
    view: View,
    side: Side,
    group: LineGroup,
    tags: Image,
    table: TagTable,
    road: Mask,
    far: int,
) -> Sighting:
    rows = np.linspace(group.top_px, group.bottom_px, 20).tolist()
    line = line_on_ground(view.ground(np.array([(group.x(row), row) for row in rows])))
    if line is None:
        return Sighting(group, None)
    if cfg.model == "line":
        std = np.array([cfg.offset_std_m, cfg.heading_std, cfg.curvature_std_per_m])
        curve: Curve | None = Curve(line, np.diag(std**2), cfg.fit_max_m)
    else:
        edges = facing_edges(table.lookup(cfg.separators)[tags], road, side, far)
        curve = fit_curve(cfg, view.ground(edges)[:, :2], line, side, 1.0 / view.camera.fx)
    if curve is None:
        return Sighting(group, None)
    outward = 1.0 if side == "left" else -1.0
    inside = _class_beside(view, curve, [-outward * d for d in _INSIDE_M], tags, table, ())
    outside = _class_beside(view, curve, [outward * d for d in _OUTSIDE_M], tags, table, ("road_line",))
    return Sighting(group, curve, inside, outside)


def _class_beside(
    view: View, curve: Curve, sideways_m: list[float], tags: Image, table: TagTable, without: tuple[str, ...]
) -> str:
    """The most frequent class on the strip beside a curve, empty where the strip is out of sight."""
    x = np.tile(_CLASS_AHEAD_M, len(sideways_m))
    y = lateral(curve.state, x) + np.repeat(sideways_m, len(_CLASS_AHEAD_M))
    pixels = view.pixels(view.on_road(x, y))
    pixels = np.rint(pixels[np.isfinite(pixels).all(axis=1)]).astype(int)
    height, width = tags.shape
    seen = ((pixels >= 0) & (pixels < (width, height))).all(axis=1)
    counts = np.bincount(tags[pixels[seen, 1], pixels[seen, 0]], minlength=len(table.names))
    counts[list(table.tags_of(without))] = 0
    return table.name_of(int(counts.argmax())) if counts.any() else ""
