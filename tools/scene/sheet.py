"""One sheet with every object's texture, each prefiltered for several distances."""

from dataclasses import dataclass
from functools import cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.geometry import Float32

from .drawings import DRAWINGS, Drawing
from .faces import Patch

LEVELS: Final = 7
GUARD: Final = 2


@dataclass(frozen=True)
class Sheet:
    """Drawings side by side; below each its copies, blurred by about 2^k texels along and 2^(k/2) upright."""

    texels: NDArray[np.uint8]
    """(LEVELS * stride, width, 4) blue, green, red, and how much of the tint a texel takes."""
    outline: NDArray[np.bool_]
    """(stride, width) what belongs to a cut face."""
    stride: int
    corners: dict[str, tuple[int, int, int, int]]
    """u, v, width and height of each drawing at level 0."""

    def patch(self, name: str, size: tuple[float, float] = (1.0, 1.0)) -> Patch:
        """The drawing on a face of which ``size`` gives the shares of width and height used, from the top left."""
        u, v, width, height = self.corners[name]
        w, h = (width - 1) * min(size[0], 1.0), (height - 1) * min(size[1], 1.0)
        return u, w, v + h, -h

    def sample(self, u: Float32, v: Float32, level: NDArray[np.int32]) -> NDArray[np.uint8]:
        """(1, N, 4) texels of (N,) coordinates at a level."""
        rows = v + (level * self.stride).astype(np.float32)
        columns = 4096
        count = -(-len(u) // columns) * columns
        maps = [np.resize(m, count).reshape(-1, columns) for m in (u, rows)]
        picked = cv2.remap(self.texels, maps[0], maps[1], cv2.INTER_LINEAR)
        return np.asarray(picked, np.uint8).reshape(1, -1, 4)[:, : len(u)]


@cache
def load_sheet() -> Sheet:
    """The sheet of all drawings; they do not depend on the seed."""
    drawn: dict[str, Drawing] = {name: draw(np.random.default_rng((i, 7))) for i, (name, draw) in enumerate(DRAWINGS)}
    stride = max(d.texels.shape[0] for d in drawn.values()) + 2 * GUARD
    width = sum(d.texels.shape[1] + 2 * GUARD for d in drawn.values())
    texels = np.zeros((LEVELS * stride, width, 4), np.uint8)
    outline = np.zeros((stride, width), np.bool_)
    corners = {}
    left = 0
    for name, drawing in drawn.items():
        height, own = drawing.texels.shape[:2]
        for level in range(LEVELS):
            copy = cv2.copyMakeBorder(_blurred(drawing.texels, level), *(GUARD,) * 4, cv2.BORDER_REPLICATE)
            texels[level * stride :][: height + 2 * GUARD, left : left + own + 2 * GUARD] = copy
        outline[GUARD : GUARD + height, left + GUARD : left + GUARD + own] = drawing.outline
        corners[name] = (left + GUARD, GUARD, own, height)
        left += own + 2 * GUARD
    return Sheet(texels, outline, stride, corners)


def _blurred(texels: NDArray[np.uint8], level: int) -> NDArray[np.uint8]:
    if level == 0:
        return texels
    blurred = cv2.GaussianBlur(
        texels, (0, 0), sigmaX=0.5 * 2**level, sigmaY=0.5 * 2 ** (level / 2), borderType=cv2.BORDER_REPLICATE
    )
    return np.asarray(blurred, np.uint8)
