"""A camera's view of the scene: colours, depth, tags and object numbers."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14

from .atlas import load_atlas
from .ego import LaneChangeState
from .faces import Body, Faces
from .ground import FAR_M, Ground, Paint, paint_on, trace_ground
from .ground_texture import make_ground_texture
from .lanes import bins
from .raster import Drawn, draw_faces
from .scenes import RenderedScene
from .shading import Shadow, cast_shadows, daylight, face_colours, ground_colours, sky_colours

ROAD, ROAD_LINE, SKY, CAR = (CARLA_FROM_0_9_14.names.index(name) for name in ("road", "road_line", "sky", "car"))
BONNET_M: Final = 1.5
"""Depth of the car's own bonnet."""
BONNET_BGR: Final = (70, 45, 35)
BONNET_DROP: Final = 0.06
"""Share of the rows by which the bonnet is lower at the image's sides."""


@dataclass(frozen=True)
class Snapshot:
    """The scene at one time; ``bodies[i]`` has object number i + 1 in the views."""

    time_s: float
    scene: RenderedScene
    s_m: float
    """Position of the ego car along the road."""
    d_m: float
    """Position of the ego car across the road, left of its centre line."""
    world_T_ego: Float
    bodies: tuple[Body, ...]
    faces: Faces
    """Faces of all bodies, fixtures included, in the world frame."""
    shadows: tuple[Shadow, ...]
    lane_change: LaneChangeState
    camera_height_m: float
    seed: int


@dataclass(frozen=True, eq=False)
class View:
    """The scene from a camera's pose; each property is computed on first access."""

    snapshot: Snapshot
    camera: Camera
    world_T_camera: Float
    bonnet: float = 0.0
    """Share of the rows that the car's own bonnet hides, in the middle of the image."""

    @cached_property
    def _bonnet(self) -> NDArray[np.bool_]:
        """Return (H, W) the pixels of the car's own bonnet."""
        height, width = self.camera.size
        drop = BONNET_DROP * np.linspace(-1, 1, width) ** 2
        return np.asarray(np.arange(height)[:, None] >= height * (1 - self.bonnet + drop))

    @cached_property
    def _ground(self) -> Ground:
        return trace_ground(self.camera, self.world_T_camera, self.snapshot.scene, self.snapshot.s_m)

    @cached_property
    def _drawn(self) -> Drawn:
        nearness = np.full(self.camera.size, 1 / FAR_M, np.float32)
        nearness[self._ground.top_row :] = np.float32(1) / self._ground.depth_m
        return draw_faces(self.camera, self.world_T_camera, self.snapshot.faces, nearness, load_atlas().outline)

    @cached_property
    def _paint(self) -> Paint | None:
        """Return the lines outside the road's cross-section."""
        markings = self.snapshot.scene.road.markings
        return paint_on(markings, self._ground, self.camera.fx) if markings else None

    @cached_property
    def owner(self) -> NDArray[np.int32]:
        """Return (H, W) the object number of each pixel, 0 for none."""
        # Index -1 (no face) selects the appended 0.
        owner = np.append(self._drawn.faces.owner, 0)[self._drawn.face].astype(np.int32)
        owner[self._bonnet] = 0
        return owner

    @cached_property
    def depth_m(self) -> Float32:
        """Return (H, W) depth in metres along the optical axis; ``FAR_M`` in the sky."""
        depth: Float32 = np.full(self.camera.size, FAR_M, np.float32)
        depth[self._ground.top_row :] = self._ground.depth_m
        faced = self._drawn.face >= 0
        depth[faced] = 1 / self._drawn.inverse_depth[faced]
        depth[self._bonnet] = BONNET_M
        return depth

    @cached_property
    def tags(self) -> NDArray[np.uint8]:
        """Return (H, W) CARLA's tags."""
        ground, drawn, section = self._ground, self._drawn, self.snapshot.scene.section
        tags = np.full(self.camera.size, SKY, np.uint8)
        index = bins(ground.d_m)
        below = section.tag_table[index]
        if section.broken:
            below[section.on_right_line(index) & ground.line_gap] = ROAD
        if self._paint is not None:
            below[self._paint.line] = ROAD_LINE
        tags[ground.top_row :] = np.where(ground.depth_m < FAR_M, below, SKY)
        faced = drawn.face >= 0
        tags[faced] = drawn.faces.tag[drawn.face[faced]]
        tags[self._bonnet] = CAR
        return tags

    @cached_property
    def rgb(self) -> NDArray[np.uint8]:
        """Return (H, W, 3) blue, green, red."""
        snapshot, camera, ground, drawn = self.snapshot, self.camera, self._ground, self._drawn
        texture = make_ground_texture(camera.fx, snapshot.camera_height_m, snapshot.seed)
        R = self.world_T_camera[:3, :3]
        picture = np.empty((*camera.size, 3), np.uint8)
        on_ground = ground.depth_m < FAR_M
        sky_rows = int(np.flatnonzero(~on_ground.all(axis=1)).max(initial=-1)) + 1 + ground.top_row
        picture[:sky_rows] = sky_colours(camera, R, sky_rows, snapshot.seed)
        brightness = np.ones(on_ground.shape, np.float32)
        cast_shadows(brightness, ground, snapshot.shadows, camera, self.world_T_camera)
        below = ground_colours(ground, snapshot.scene.section, texture, brightness, self._paint)
        cv2.copyTo(below, on_ground.view(np.uint8), picture[ground.top_row :])
        pixels = np.flatnonzero(drawn.face >= 0)
        if len(pixels):
            light = daylight(drawn.faces.across @ R.T, drawn.faces.up @ R.T, drawn.faces.two_sided)
            picture.reshape(-1, 3)[pixels] = face_colours(drawn, load_atlas(), pixels, light)
        picture[self._bonnet] = BONNET_BGR
        return np.asarray(cv2.GaussianBlur(picture, (3, 3), 0.55), np.uint8)
