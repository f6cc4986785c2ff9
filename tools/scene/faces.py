"""Planar faces in bulk: parallelograms with a texture, and boxes and extrusions made of them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float, transform
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14

Patch = tuple[float, float, float, float]
"""u0, du, v0, dv: texture coordinates u0 + a du, v0 + b dv of a face's point origin + a across + b up, texels."""
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Faces:
    """N parallelograms; ``across`` x ``up`` points outward, and only faces seen from outside are drawn."""

    origin: Float
    """(N, 3) the corner at the lower left, seen from outside."""
    across: Float
    up: Float
    patch: Float
    """(N, 4), see ``Patch``."""
    tint: Float
    """(N, 3) blue, green, red factors of what is painted."""
    tag: NDArray[np.uint8]
    owner: NDArray[np.int32]
    """Number of the object a face belongs to, 0 for none."""
    cut: NDArray[np.bool_]
    """Whether the texture's outline cuts the face."""
    two_sided: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.origin)

    def moved(self, a_T_b: Float) -> "Faces":
        """The same faces in another frame."""
        rotation = a_T_b[:3, :3].T
        return replace(self, origin=transform(a_T_b, self.origin), across=self.across @ rotation, up=self.up @ rotation)

    def owned_by(self, owner: int) -> "Faces":
        """The same faces as parts of one object."""
        return replace(self, owner=np.full(len(self), owner, np.int32))

    def pick(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "Faces":
        """A selection, in the order given."""
        return Faces(*(getattr(self, field.name)[chosen] for field in fields(self)))


def together(groups: Sequence[Faces]) -> Faces:
    """All faces of several groups, in order; at least one group is needed."""
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
    """One face, in metres of its own frame."""
    return Faces(
        np.array([origin], float),
        np.array([across], float),
        np.array([up], float),
        np.array([patch], float),
        np.array([tint], float),
        np.array([CARLA_FROM_0_9_14.names.index(tag_name)], np.uint8),
        np.zeros(1, np.int32),
        np.array([cut]),
        np.array([two_sided]),
    )


def box(centre: Vector, size: Vector, patch: Patch, tint: Vector, tag_name: str, lean: float = 0.0) -> Faces:
    """A box without its underside; ``lean`` shears it along x, in metres from bottom to top."""
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
    """A face that spans the width of a body between two points (x, z) of its side view.

    Taken counterclockwise as seen from the right side, start to end faces outward. What slopes down is turned, so that
    its texture stands upright.
    """
    (x0, z0), (x1, z1) = start, end
    if z1 >= z0:
        return face((x0, -width / 2, z0), (0.0, width, 0.0), (x1 - x0, 0.0, z1 - z0), patch, tint, tag_name)
    return face((x1, width / 2, z1), (0.0, -width, 0.0), (x0 - x1, 0.0, z0 - z1), patch, tint, tag_name)
