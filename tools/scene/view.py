"""One camera's picture of the world: colours, depth, tags and who is where."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14

from .faces import Faces
from .grain import make_grain
from .ground import FAR_M, Ground, Paint, paint_on, trace_ground
from .lanes import RoadSection, bins
from .raster import Drawn, draw_faces
from .shade import Shadow, cast_shadows, daylight, shade_faces, shade_ground, shade_sky
from .sheet import load_sheet
from .world import World

ROAD, ROAD_LINE, SKY = (CARLA_FROM_0_9_14.names.index(name) for name in ("road", "road_line", "sky"))


@dataclass(frozen=True)
class Scenery:
    """What one moment shows, in the world: it is the same for every camera."""

    world: World
    s_m: float
    """Where along the road the cameras are."""
    faces: Faces
    shadows: tuple[Shadow, ...]
    camera_height_m: float
    seed: int


@dataclass(frozen=True)
class RenderedView:
    """What a camera sees; all arrays (H, W), colours (H, W, 3) blue, green, red."""

    rgb: NDArray[np.uint8]
    depth_m: Float32
    tags: NDArray[np.uint8]
    owner: NDArray[np.int32]
    """Number of the object in each pixel, 0 for none."""


@dataclass(frozen=True)
class _Sight:
    """What is where in a picture, before it has colours."""

    camera: Camera
    world_T_camera: Float
    ground: Ground
    drawn: Drawn
    paint: Paint | None
    """Lines that are not in the road's cross-section."""


def render(scenery: Scenery, camera: Camera, world_T_camera: Float) -> RenderedView:
    """The scenery from a camera's pose in the world."""
    sight = _look(scenery, camera, world_T_camera)
    ground, drawn = sight.ground, sight.drawn
    # Index -1, no face, takes the last entry.
    owner = np.append(drawn.faces.owner, 0)[drawn.face].astype(np.int32)
    return RenderedView(_colours(scenery, sight), _depth(ground, drawn), _tags(sight, scenery.world.section), owner)


def photograph(scenery: Scenery, camera: Camera, world_T_camera: Float) -> NDArray[np.uint8]:
    """(H, W, 3) the colours alone."""
    return _colours(scenery, _look(scenery, camera, world_T_camera))


def depth_seen(scenery: Scenery, camera: Camera, world_T_camera: Float) -> Float32:
    """(H, W) the depth alone, metres along the optical axis; ``FAR_M`` where the sky is."""
    sight = _look(scenery, camera, world_T_camera)
    return _depth(sight.ground, sight.drawn)


def _look(scenery: Scenery, camera: Camera, world_T_camera: Float) -> _Sight:
    ground = trace_ground(camera, world_T_camera, scenery.world, scenery.s_m)
    nearness = np.full(camera.size, 1 / FAR_M, np.float32)
    nearness[ground.top_row :] = np.float32(1) / ground.depth_m
    drawn = draw_faces(camera, world_T_camera, scenery.faces, nearness, load_sheet().outline)
    markings = scenery.world.road.markings
    return _Sight(camera, world_T_camera, ground, drawn, paint_on(markings, ground, camera.fx) if markings else None)


def _depth(ground: Ground, drawn: Drawn) -> Float32:
    """Depth along the optical axis; the ground's is kept as it was computed, not inverted twice."""
    depth: Float32 = np.full(drawn.face.shape, FAR_M, np.float32)
    depth[ground.top_row :] = ground.depth_m
    faced = drawn.face >= 0
    depth[faced] = 1 / drawn.inverse_depth[faced]
    return depth


def _tags(sight: _Sight, section: RoadSection) -> NDArray[np.uint8]:
    ground, drawn = sight.ground, sight.drawn
    tags = np.full(drawn.face.shape, SKY, np.uint8)
    index = bins(ground.d_m)
    below = section.tag_table[index]
    if section.broken:
        below[section.right_line_table[index] & ground.line_gap] = ROAD
    if sight.paint is not None:
        below[sight.paint.line] = ROAD_LINE
    tags[ground.top_row :] = np.where(ground.depth_m < FAR_M, below, SKY)
    faced = drawn.face >= 0
    tags[faced] = drawn.faces.tag[drawn.face[faced]]
    return tags


def _colours(scenery: Scenery, sight: _Sight) -> NDArray[np.uint8]:
    camera, world_T_camera, ground, drawn = sight.camera, sight.world_T_camera, sight.ground, sight.drawn
    grain = make_grain(camera.fx, scenery.camera_height_m, scenery.seed)
    R = world_T_camera[:3, :3]
    picture = np.empty((*camera.size, 3), np.uint8)
    on_ground = ground.depth_m < FAR_M
    sky_rows = int(np.flatnonzero(~on_ground.all(axis=1)).max(initial=-1)) + 1 + ground.top_row
    picture[:sky_rows] = shade_sky(camera, R, sky_rows, scenery.seed)
    brightness = np.ones(on_ground.shape, np.float32)
    cast_shadows(brightness, ground, scenery.shadows, camera, world_T_camera)
    below = shade_ground(ground, scenery.world.section, grain, brightness, sight.paint)
    cv2.copyTo(below, on_ground.view(np.uint8), picture[ground.top_row :])
    pixels = np.flatnonzero(drawn.face >= 0)
    if len(pixels):
        light = daylight(drawn.faces.across @ R.T, drawn.faces.up @ R.T, drawn.faces.two_sided)
        picture.reshape(-1, 3)[pixels] = shade_faces(drawn, load_sheet(), pixels, light)
    return np.asarray(cv2.GaussianBlur(picture, (3, 3), 0.55), np.uint8)
