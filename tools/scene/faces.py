"""Textured parallelograms in arrays, and the bodies built from them: cars, people, houses, trees, lamp posts.

The frame of a body is x forward, y left, z up. Its origin is on the ground below the body's centre.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float, transform
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14

from .atlas import CAR_M, CAR_PROFILE, CAR_WIDTH_M, CROWN_M, DRAWINGS, FACADE_M, PLAIN_M, WHEELS, Patch, load_atlas

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Faces:
    """N parallelograms; ``across`` x ``up`` points outward, and only outer sides are drawn."""

    origin: Float
    """(N, 3) lower left corner as seen from outside."""
    across: Float
    up: Float
    patch: Float
    """(N, 4), see ``Patch``."""
    tint: Float
    """(N, 3) blue, green, red factors for painted texels."""
    tag: NDArray[np.uint8]
    owner: NDArray[np.int32]
    """Number of the object that a face belongs to, 0 for none."""
    cut: NDArray[np.bool_]
    """True if the texture's outline cuts the face."""
    two_sided: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.origin)

    @property
    def corners(self) -> Float:
        """Return (N, 4, 3) corners in order around each face."""
        a, b = self.across, self.up
        return self.origin[:, None] + np.stack((np.zeros_like(a), a, a + b, b), axis=1)

    def moved(self, a_T_b: Float) -> "Faces":
        """Return the faces in another frame."""
        rotation = a_T_b[:3, :3].T
        return replace(self, origin=transform(a_T_b, self.origin), across=self.across @ rotation, up=self.up @ rotation)

    def owned_by(self, owner: int) -> "Faces":
        """Return the faces as faces of one object."""
        return replace(self, owner=np.full(len(self), owner, np.int32))

    def pick(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "Faces":
        """Return the chosen faces in that order."""
        return Faces(*(getattr(self, field.name)[chosen] for field in fields(self)))


def together(groups: Sequence[Faces]) -> Faces:
    """Concatenate one or more groups of faces."""
    return Faces(*(np.concatenate([getattr(g, field.name) for g in groups]) for field in fields(Faces)))


def face(
    origin: Vector,
    across: Vector,
    up: Vector,
    patch: Patch,
    tint: Vector,
    tag_name: str,
    *,
    cut: bool = False,
    two_sided: bool = False,
) -> Faces:
    """Return one face, in metres in the body's frame."""
    start, a, b, texture, colour = (np.array([row], float) for row in (origin, across, up, patch, tint))
    tag = np.array([CARLA_FROM_0_9_14.names.index(tag_name)], np.uint8)
    return Faces(start, a, b, texture, colour, tag, np.zeros(1, np.int32), np.array([cut]), np.array([two_sided]))


def box(centre: Vector, size: Vector, patch: Patch, tint: Vector, tag_name: str, lean: float = 0.0) -> Faces:
    """Return a box without underside; ``lean`` shears it along x, in metres from bottom to top."""
    (x, y, z), (length, width, height) = centre, size
    x0, x1, y0, y1 = x - length / 2, x + length / 2, y - width / 2, y + width / 2
    low, up = z - height / 2, (lean, 0.0, height)
    sides = [
        ((x1, y0, low), (0.0, width, 0.0), up),
        ((x0, y1, low), (0.0, -width, 0.0), up),
        ((x1, y1, low), (-length, 0.0, 0.0), up),
        ((x0, y0, low), (length, 0.0, 0.0), up),
        ((x0 + lean, y0, low + height), (length, 0.0, 0.0), (0.0, width, 0.0)),
    ]
    return together([face(*side, patch, tint, tag_name) for side in sides])


def ribbon(
    start: tuple[float, float], end: tuple[float, float], width: float, patch: Patch, tint: Vector, tag_name: str
) -> Faces:
    """Return a face over the width of a body between two points (x, z) of its side view.

    It faces outward if start and end go counterclockwise as seen from the right. Faces that slope down are rotated so
    that the texture is upright.
    """
    (x0, z0), (x1, z1) = start, end
    if z1 >= z0:
        return face((x0, -width / 2, z0), (0.0, width, 0.0), (x1 - x0, 0.0, z1 - z0), patch, tint, tag_name)
    return face((x1, width / 2, z1), (0.0, -width, 0.0), (x0 - x1, 0.0, z0 - z1), patch, tint, tag_name)


@dataclass(frozen=True)
class Body:
    """A body in the scene: its faces, and its pose (world_T_body) at any time in seconds."""

    name: str
    label: str
    """``Car`` or ``Pedestrian``; empty for bodies that are not objects."""
    faces: Faces
    pose: Callable[[float], Float]


CAR_COLOURS: Final[tuple[Vector, ...]] = (
    (0.62, 0.28, 0.12), (0.16, 0.14, 0.66), (0.95, 0.95, 0.95), (0.28, 0.27, 0.26), (0.62, 0.62, 0.60),
    (0.20, 0.42, 0.24), (0.25, 0.62, 0.82), (0.70, 0.52, 0.25),
)  # fmt: skip
CLOTHES: Final[tuple[Vector, ...]] = (
    (0.55, 0.25, 0.18), (0.16, 0.16, 0.55), (0.75, 0.75, 0.75), (0.2, 0.2, 0.2), (0.25, 0.5, 0.7), (0.3, 0.45, 0.25),
)  # fmt: skip
SKIN: Final[Vector] = (0.55, 0.66, 0.86)
STEEL: Final[Vector] = (0.5, 0.5, 0.48)
BARK: Final[Vector] = (0.22, 0.28, 0.34)
FACADES: Final = tuple(name for name, _ in DRAWINGS if name.startswith("facade"))
FOUNDATION_M: Final = 2.5
"""Depth of walls below the ground, so that no house floats on a slope."""


@cache
def car(colour: int) -> Faces:
    """Return a car 4.3 m long: two cut side views and the faces between them."""
    atlas, tint = load_atlas(), CAR_COLOURS[colour % len(CAR_COLOURS)]
    length, height = CAR_M
    rear, half = -length / 2, CAR_WIDTH_M / 2

    def side(x: float, y: float, across: float, patch: Patch) -> Faces:
        return face((x, y, 0.0), (across, 0.0, 0.0), (0.0, 0.0, height), patch, tint, "car", cut=True)

    u, du, v, dv = atlas.patch("car_side")
    right, left = side(rear, -half, length, (u, du, v, dv)), side(-rear, half, -length, (u + du, -du, v, dv))
    return together([right, left, *_skin(rear, tint), *_tyres(rear, half)])


def _skin(rear: float, tint: Vector) -> list[Faces]:
    """Return the faces between the two sides of a car, without the floor."""
    corners = [(x + rear, z) for x, z in CAR_PROFILE]
    textures = {1: "car_nose", 4: "glass", 6: "glass", 8: "car_tail"}
    patches = {i: load_atlas().patch(name) for i, name in textures.items()}
    spans = list(enumerate(pairwise([*corners, corners[0]])))[1:]
    plain = plain_patch(1.8, 1.0)
    return [ribbon(*span, CAR_WIDTH_M, patches.get(i, plain), tint, "car") for i, span in spans]


def _tyres(rear: float, half: float) -> list[Faces]:
    """Return the tyres as seen from the front and from behind."""
    dark, patch = (0.13, 0.13, 0.13), plain_patch(0.2, 0.4)
    ends = (rear + WHEELS[0][0] - 0.2, rear + WHEELS[1][0] + 0.2)
    tyres = []
    for y in (-half + 0.02, half - 0.22):
        tyres.append(face((ends[0], y + 0.2, 0.0), (0.0, -0.2, 0.0), (0.0, 0.0, 0.4), patch, dark, "car"))
        tyres.append(face((ends[1], y, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.4), patch, dark, "car"))
    return tyres


def pedestrian(clothes: int, stride_m: float) -> Faces:
    """Return a person 1.75 m tall; ``stride_m`` is the distance of the left foot in front of the hips."""
    jacket, trousers = CLOTHES[clothes % len(CLOTHES)], CLOTHES[(clothes * 5 + 3) % len(CLOTHES)]
    patch = plain_patch(0.4, 0.6)
    parts = [((0.0, 0.0, 1.13), (0.26, 0.44, 0.6), jacket, 0.0), ((0.02, 0.0, 1.6), (0.2, 0.18, 0.26), SKIN, 0.0)]
    for y, foot in ((0.11, stride_m), (-0.11, -stride_m)):
        parts.append(((foot, y, 0.42), (0.15, 0.16, 0.84), trousers, -foot))
    for y, hand in ((0.27, -stride_m), (-0.27, stride_m)):
        parts.append(((hand * 0.8, y, 1.13), (0.11, 0.1, 0.56), jacket, -hand * 0.8))
    return together([box(c, size, patch, tint, "pedestrian", lean) for c, size, tint, lean in parts])


@cache
def lamp_post(towards: int) -> Faces:
    """Return a lamp post whose arm points left (+1) or right (-1)."""
    post = box((0.0, 0.0, 3.0), (0.16, 0.16, 6.0), plain_patch(0.2, 4.0), STEEL, "pole")
    arm = box((0.0, towards * 0.7, 5.95), (0.1, 1.5, 0.1), plain_patch(1.5, 0.2), STEEL, "pole")
    lamp = box((0.0, towards * 1.5, 5.95), (0.25, 0.6, 0.14), plain_patch(0.6, 0.3), (0.7, 0.7, 0.7), "pole")
    return together([post, arm, lamp])


@cache
def tree() -> Faces:
    """Return a tree: a trunk, and a crown of three crossing cut faces."""
    size, patch = CROWN_M, load_atlas().patch("crown")
    trunk = box((0.0, 0.0, 1.2), (0.24, 0.24, 2.4), plain_patch(0.3, 2.4), BARK, "vegetation")
    cards = []
    for angle in np.radians((20.0, 80.0, 140.0)):
        x, y = float(np.cos(angle)) * size, float(np.sin(angle)) * size
        corner, up = (-x / 2, -y / 2, 2.0), (0.0, 0.0, size)
        cards.append(face(corner, (x, y, 0.0), up, patch, (1.0, 1.0, 1.0), "vegetation", cut=True, two_sided=True))
    return together([trunk, *cards])


def building(style: int, length_m: float, depth_m: float, height_m: float, tint: Vector) -> Faces:
    """Return a house with the centre of its front at the origin, facing +y; the house extends towards -y."""
    atlas, name = load_atlas(), FACADES[style % len(FACADES)]
    height = height_m + FOUNDATION_M
    up, half = (0.0, 0.0, height), length_m / 2

    def wall(origin: tuple[float, float], across: tuple[float, float], width: float) -> Faces:
        patch = atlas.patch(name, (width / FACADE_M[0], height / FACADE_M[1]))
        return face((*origin, -FOUNDATION_M), (*across, 0.0), up, patch, tint, "building")

    back = -depth_m
    grey, top = (0.4, 0.4, 0.4), ((-half, back, height_m), (length_m, 0.0, 0.0), (0.0, depth_m, 0.0))
    front = wall((half, 0.0), (-length_m, 0.0), length_m)
    sides = (wall((-half, 0.0), (0.0, back), depth_m), wall((half, back), (0.0, depth_m), depth_m))
    return together([front, *sides, face(*top, plain_patch(4, 4), grey, "building")])


def plain_patch(width_m: float, height_m: float) -> Patch:
    """Return the section of the plain texture that a face of this size shows."""
    return load_atlas().patch("plain", (width_m / PLAIN_M, height_m / PLAIN_M))
