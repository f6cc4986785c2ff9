"""Draw faces into a buffer of inverse depths: exact per pixel; the nearest face wins.

For a face origin + a across + b up in the camera frame, H = [across up origin]^-1 K^-1 maps a pixel (u, v, 1) to q with
a = q0 / q2, b = q1 / q2 and depth 1 / q2: inside test, texture coordinate and depth are linear in the pixel.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera, Float, Float32, inverse

from .faces import Faces

NEAR_M: Final = 0.1


@dataclass(frozen=True)
class Drawn:
    """The face of each pixel (H, W), -1 for none, and the matrices from pixels to face coordinates."""

    face: NDArray[np.int32]
    inverse_depth: Float32
    faces: Faces
    H: Float
    """(N, 3, 3) maps a pixel to (a, b, 1) over depth."""


def draw_faces(
    camera: Camera, world_T_camera: Float, faces: Faces, inverse_depth: Float32, outline: NDArray[np.bool_]
) -> Drawn:
    """Draw all faces, given in the world frame.

    ``inverse_depth`` (H, W) holds the picture before, and changes in place. ``outline`` marks the visible texels of cut
    faces (see ``Atlas``).
    """
    seen = _facing(faces.moved(inverse(world_T_camera)))
    H = np.linalg.inv(np.stack((seen.across, seen.up, seen.origin), axis=-1)) @ np.linalg.inv(camera.K)
    boxes = pixel_boxes(camera, seen.corners)
    owner = np.full(camera.size, -1, np.int32)
    for i in np.flatnonzero((boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])):
        x0, y0, x1, y1 = boxes[i]
        texture = (seen.patch[i], outline) if seen.cut[i] else None
        _draw(H[i], (x0, y0), inverse_depth[y0:y1, x0:x1], owner[y0:y1, x0:x1], int(i), texture)
    return Drawn(owner, inverse_depth, seen, H)


def _draw(
    H: Float,
    corner: tuple[int, int],
    inverse_depth: Float32,
    owner: NDArray[np.int32],
    number: int,
    texture: tuple[Float, NDArray[np.bool_]] | None,
) -> None:
    """Draw one face into its box of the buffers; a texture's patch and outline cut it."""
    height, width = inverse_depth.shape
    u, v = np.arange(corner[0], corner[0] + width), np.arange(corner[1], corner[1] + height)[:, None]
    q2 = (H[2, 0] * u) + (H[2, 1] * v + H[2, 2])
    inside = q2 > inverse_depth
    if not inside.any():
        return
    for i in (0, 1):
        q = (H[i, 0] * u) + (H[i, 1] * v + H[i, 2])
        inside &= q >= 0
        inside &= q <= q2
    if texture is not None:
        (u0, du, v0, dv), outline = texture
        y, x = np.nonzero(inside)
        q0, q1, q2_there = H @ np.stack((x + corner[0], y + corner[1], np.ones(len(x))))
        column = np.rint(u0 + du * q0 / q2_there).astype(np.intp)
        row = np.rint(v0 + dv * q1 / q2_there).astype(np.intp)
        inside[y, x] = outline[row, column]
    np.copyto(inverse_depth, q2, where=inside, casting="same_kind")
    owner[inside] = number


def _facing(faces: Faces) -> Faces:
    """Return the faces that show their outer side and have a corner in front of the camera; in the camera frame."""
    normal = np.cross(faces.across, faces.up)
    towards = np.einsum("ij,ij->i", normal, faces.origin)
    size = np.linalg.norm(normal, axis=1)
    ahead = faces.corners[..., 2].max(axis=1) > NEAR_M
    return faces.pick(ahead & np.where(faces.two_sided, np.abs(towards) > 1e-6 * size, towards < -1e-6 * size))


def pixel_boxes(camera: Camera, corners: Float) -> NDArray[np.int64]:
    """Return (N, 4) half-open pixel boxes x0, y0, x1, y1 of polygons, clipped to the near plane and the image.

    ``corners`` are (N, M, 3) in the camera frame, in order around each polygon. Invisible polygons have empty boxes.
    """
    following = np.roll(corners, -1, axis=1)
    z, z_next = corners[..., 2], following[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (NEAR_M - z) / (z_next - z)
        crossing = corners + share[..., None] * (following - corners)
    crosses = (z > NEAR_M) != (z_next > NEAR_M)
    points = np.concatenate((corners, np.where(crosses[..., None], crossing, 0.0)), axis=1)
    valid = np.concatenate((z > NEAR_M, crosses), axis=1)
    depth = np.where(valid, points[..., 2], 1.0)
    u = camera.fx * points[..., 0] / depth + camera.cx
    v = camera.fy * points[..., 1] / depth + camera.cy
    low = [np.where(valid, c, np.inf).min(axis=1) for c in (u, v)]
    high = [np.where(valid, c, -np.inf).max(axis=1) for c in (u, v)]
    limits = (camera.width, camera.height)
    starts = [np.clip(np.ceil(c), 0, n).astype(np.int64) for c, n in zip(low, limits, strict=True)]
    ends = [np.clip(np.floor(c) + 1, 0, n).astype(np.int64) for c, n in zip(high, limits, strict=True)]
    return np.column_stack((*starts, *ends))
