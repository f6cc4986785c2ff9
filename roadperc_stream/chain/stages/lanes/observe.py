"""Both boundaries of the ego lane in a single frame, without state."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from roadperc_stream.chain.stages.lanes import curves, lines
from roadperc_stream.chain.stages.lanes.curves import Curve, Edges, lateral, outward
from roadperc_stream.chain.stages.lanes.lines import LineGroup
from roadperc_stream.config import LanesConfig
from roadperc_stream.geometry import Camera, Float, inverse, project, transform
from roadperc_stream.geometry.ground import ground_points, height_at
from roadperc_stream.model import SIDES, Image, Mask, Side, Surface
from roadperc_stream.model.frame import mark
from roadperc_stream.model.tag_tables import TagTable

_FRINGE_PX = 4
"""Largest number of pixels of other classes between a separator and the road; compression may cause them."""
_INSIDE_M = (0.2, 0.4, 0.6)
_OUTSIDE_M = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Distances beside a boundary at which the class there is sampled; a double marking is 0.35 m wide."""
_MARKINGS = ("road_line",)
_LINE_SAMPLES = 20
_BEGINS_M = 11.0
"""Distance beyond a bonnet up to which a boundary's nearest support may lie; a gap between dashes is shorter."""
_LINE_STD = np.array([0.05, 0.01, 0.002])
"""Standard deviations of the offset (m), heading (rad) and curvature (1/m) of a line by the model ``line``."""
_CLASS_AHEAD_M = np.arange(4.0, 14.0, 0.5)


@dataclass(frozen=True)
class RoadProjection:
    """From pixels to points on the road and back."""

    camera: Camera
    ego_T_camera: Float
    surface: Surface

    def ground(self, pixels: Float) -> Float:
        """(N, 3) ego points on the road of (N, 2) pixels, NaN above the horizon."""
        return ground_points(self.surface, self.camera, self.ego_T_camera, pixels)

    def on_road(self, x: Float, y: Float) -> Float:
        """(N, 3) ego points on the road at (N,) x and y."""
        return np.stack((x, y, height_at(self.surface, x, y)), axis=-1)

    def pixels(self, points: Float) -> Float:
        """(N, 2) pixels of (N, 3) ego points, NaN behind the camera."""
        return project(self.camera, transform(self._camera_T_ego, points))

    @cached_property
    def _camera_T_ego(self) -> Float:
        return inverse(self.ego_T_camera)

    def ahead_m(self, row: float) -> float:
        """Distance ahead of the road in the middle of a row, metres; NaN above the horizon."""
        return float(self.ground(np.array([[self.camera.cx, row]]))[0, 0])

    @cached_property
    def nearest_m(self) -> float:
        """Distance ahead of the road at the image's bottom edge, metres; NaN above the horizon."""
        return self.ahead_m(float(self.camera.height))


@dataclass(frozen=True)
class Observation:
    """The lane as observed in one frame, between the rows of the road's far end and of its lower end.

    The lower end ``bottom`` is the image's bottom edge, or the upper edge of the car's own bonnet.

    ``edge_pixels`` are those along which lines were proposed, in every ``lines.pixel_step``-th row and column.
    ``edges`` are those that face the ego lane.
    """

    projection: RoadProjection
    tags: Image
    table: TagTable
    far: float
    bottom: float
    edge_pixels: Mask | None = None
    proposals: Float = field(default_factory=lambda: np.empty((0, 4)))
    groups: tuple[LineGroup, ...] = ()
    edges: dict[Side, Edges] = field(default_factory=dict)
    near: dict[Side, tuple[LineGroup, ...]] = field(default_factory=dict)
    """The lines on either side with support near the car, the closest one first."""
    curves: dict[Side, Curve | None] = field(default_factory=dict)
    """The curve on the road of the closest line on either side, None if no curve fits."""

    @property
    def hidden_m(self) -> float:
        """Distance ahead up to which a bonnet hides the road; 0 without one."""
        if self.bottom >= self.projection.camera.height:
            return 0.0
        nearest_m = self.projection.ahead_m(self.bottom)
        return nearest_m if np.isfinite(nearest_m) else 0.0

    @property
    def near_m(self) -> float:
        """Largest distance ahead of a boundary's nearest support."""
        return max(curves.NEAR_M, self.hidden_m + _BEGINS_M)

    def curve_beyond(self, cfg: LanesConfig, side: Side, least_m: float) -> Curve | None:
        """The curve of the closest line that lies at least this far out at the ego origin."""
        fitted = (_curve(cfg, self, side, group) for group in self.near.get(side, ()))
        return next((c for c in fitted if c is not None and outward(side) * float(c.state[0]) > least_m), None)

    def curve_along(self, cfg: LanesConfig, side: Side, line: Float) -> Curve | None:
        """The curve of the edges near a (3,) state; None if there are too few."""
        if side not in self.edges:
            return None
        fx = self.projection.camera.fx
        return curves.fit_curve(cfg, self.edges[side], line, side, 1.0 / fx, self.near_m)

    def classes_beside(self, side: Side, curve: Curve) -> tuple[str, str]:
        """The classes inside and outside a boundary, empty if not visible."""
        at_m = outward(side) * np.array([-d for d in _INSIDE_M] + list(_OUTSIDE_M))
        ahead_m = _CLASS_AHEAD_M + max(self.hidden_m - _CLASS_AHEAD_M[0], 0.0)
        x = np.broadcast_to(ahead_m, (len(at_m), len(ahead_m)))
        y = lateral(curve.state, x) + at_m[:, None]
        pixels = self.projection.pixels(self.projection.on_road(x.ravel(), y.ravel()))
        height, width = self.tags.shape
        with np.errstate(invalid="ignore"):
            columns, rows = np.rint(pixels.T)
            visible = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        tags = self.tags[rows[visible].astype(int), columns[visible].astype(int)]
        is_inside = np.flatnonzero(visible) < len(_INSIDE_M) * len(ahead_m)
        return self._most_frequent(tags[is_inside], ()), self._most_frequent(tags[~is_inside], _MARKINGS)

    def _most_frequent(self, tags: Image, without: tuple[str, ...]) -> str:
        """The most frequent class of (N,) tags; empty if there is none."""
        counts = np.bincount(tags, minlength=len(self.table.names))
        counts[list(self.table.tags_of(without))] = 0
        return self.table.name_of(int(counts.argmax())) if counts.any() else ""


def facing_edges(separators: Image, drivable: Mask, top: int, step: int = 1) -> dict[Side, Float]:
    """(N, 2) pixels on the edges between a separator and the road beside it, for each side of the ego lane.

    Row by row from above, those of a row outermost first. ``separators`` (h, W) are 1, in every ``step``-th row from
    ``top`` down; ``drivable`` is (H, W). The edges of a left boundary face right. Up to ``_FRINGE_PX`` pixels of other
    classes may lie between separator and road.
    """
    width, marked, road = separators.shape[1], separators.ravel(), drivable[top::step].ravel()
    before = np.flatnonzero(marked[:-1] != marked[1:])  # the ends of all runs of separators
    faces_right = marked[before] > 0
    ends, towards = before + ~faces_right, np.where(faces_right, 1, -1)
    columns = ends % width
    gap = np.full(len(ends), -1)
    sought = np.flatnonzero((columns + towards >= 0) & (columns + towards < width))  # else that is in another row
    for between in range(_FRINGE_PX + 1):
        beyond = np.clip(columns[sought] + towards[sought] * (1 + between), 0, width - 1) + (ends - columns)[sought]
        is_marked = marked[beyond] > 0
        met = road[beyond] & ~is_marked
        gap[sought[met]] = between
        sought = sought[~(met | is_marked)]
    left, right = (np.flatnonzero((gap >= 0) & (towards == round(outward(side)))) for side in SIDES)
    right = right[np.argsort(ends[right] - 2 * columns[right])]  # mirrored: the columns of a row descend
    pixels = np.stack((columns + towards * 0.5 * (gap + 1), ends // width * step + float(top)), axis=-1)
    return {"left": pixels[left], "right": pixels[right]}


def observe(cfg: LanesConfig, projection: RoadProjection, tags: Image, table: TagTable, drivable: Mask) -> Observation:
    """Find the ego lane's boundaries in one frame, from (H, W) tags and its (H, W) drivable surface."""
    height = len(tags)
    rows = lines.road_rows(drivable)
    if rows is None:
        return Observation(projection, tags, table, float(projection.camera.cy), float(height))
    far, bottom = rows
    step, lookup = lines.pixel_step(cfg, height), table.lookup(cfg.separators)
    edge_pixels = lines.edges_of(cfg, mark(tags[::step, ::step], lookup))
    proposals = lines.propose(cfg, edge_pixels, lines.visible_share(far, bottom, height), step)
    groups = lines.merge(lines.on_road(proposals * step, drivable), height)
    edges = _edges(projection, mark(tags[far::step], lookup), drivable, far, step) if cfg.model == "curve" else {}
    ends = float(far), float(bottom)
    found = Observation(projection, tags, table, *ends, edge_pixels > 0, proposals * step, groups, edges)
    near = _near_lines(found)
    closest = {side: _curve(cfg, found, side, lines_near[0]) for side, lines_near in near.items()}
    return replace(found, near=near, curves=closest)


def _edges(projection: RoadProjection, separators: Image, drivable: Mask, top: int, step: int) -> dict[Side, Edges]:
    """``facing_edges`` on the ground."""
    pixels = facing_edges(separators, drivable, top, step)
    points = np.split(projection.ground(np.concatenate([*pixels.values()]))[:, :2], [len(pixels["left"])])
    return {side: Edges.of(at, pixels[side][:, 1], step) for side, at in zip(pixels, points, strict=True)}


def _near_lines(observation: Observation) -> dict[Side, tuple[LineGroup, ...]]:
    """The lines on each side of the car's path at the road's lower end, among those with near support, closest first.

    A short fragment far away would otherwise extrapolate to the closest position.
    """
    groups, bottom, width = observation.groups, observation.bottom, float(observation.projection.camera.width)
    if not groups:
        return {}
    ends = [(group.x(group.bottom_px), group.bottom_px) for group in groups]
    x, y, _ = observation.projection.ground(np.array([(0.0, bottom), (width, bottom), *ends])).T.tolist()
    path, near_m = y[0] / (y[0] - y[1]) * width, observation.near_m  # the path is y = 0
    near = [group for group, x in zip(groups, x[2:], strict=True) if x <= near_m]  # NaN is not near
    left = [group for group in near if group.x(bottom) < path and group.slope < 0]
    right = [group for group in near if group.x(bottom) >= path and group.slope > 0]
    closest_first: dict[Side, tuple[LineGroup, ...]] = {
        "left": tuple(sorted(left, key=lambda group: -group.x(bottom))),
        "right": tuple(sorted(right, key=lambda group: group.x(bottom))),
    }
    return {side: groups for side, groups in closest_first.items() if groups}


def _curve(cfg: LanesConfig, observation: Observation, side: Side, group: LineGroup) -> Curve | None:
    """The boundary on the road: the Hough line itself in the line model, else the edges along it."""
    rows = np.linspace(group.top_px, group.bottom_px, _LINE_SAMPLES)
    line = curves.line_on_ground(observation.projection.ground(np.stack((group.x(rows), rows), axis=-1)))
    if line is None or cfg.model == "curve":
        return None if line is None else observation.curve_along(cfg, side, line)
    return Curve(line, np.diag(_LINE_STD**2), curves.FIT_MAX_M)
