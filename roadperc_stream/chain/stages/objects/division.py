"""The pixels of a class divided into regions: by the instance masks, or where the depth jumps.

Neighbours are of one region where their depths differ by less than a share of them. No single share is right, so there
are regions of several. What a larger one allows joins regions of the smallest one, so that the pixels are divided once.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.mosaic import Indices, Mosaic
from roadperc_stream.core.datatypes import Ids, Image
from roadperc_stream.core.kernels.division import divided, numbered

JUMPS = np.array((0.02, 0.04, 0.08), np.float32)
"""Differences of depth between neighbours, as a share of it, from which they are of different regions."""

Labels = NDArray[np.int32]


@dataclass(frozen=True)
class Division:
    """K regions of a mosaic of (H, W) pixels, by n ways to divide it, those of an earlier way before the others.

    ``labels`` (H, W) are those of the first way, 0 of no region and k + 1 of region k; ``names`` (n, labels) are what
    each label is called in each way. ``ways`` (K,) are the regions' own, ``bounds`` (4, K) their first column and row
    in the mosaic and those behind their last, ``pixels`` (K,) how many each has.
    """

    labels: Labels
    names: Indices
    ways: Indices
    bounds: Indices
    pixels: Indices

    def of_region(self, k: int) -> tuple[NDArray[np.bool_], tuple[slice, slice]]:
        """(labels,) which labels are a region's, and where its bounds are in the mosaic: no other pixels have them."""
        x0, y0, x1, y1 = self.bounds[:, k].tolist()
        inside: NDArray[np.bool_] = self.names[self.ways[k]] == k + 1
        return inside, (slice(y0, y1), slice(x0, x1))


def divide(mosaic: Mosaic) -> Division:
    """The regions of a mosaic; none where it has neither instance masks nor depth, or no pixels."""
    if mosaic.ids is not None:
        return _by_instance(mosaic.ids, mosaic.of_class, mosaic.tops)
    if mosaic.log_depth is not None:
        return Division(*divided(mosaic.log_depth, mosaic.of_class, JUMPS))
    return Division(*numbered(np.zeros(mosaic.of_class.shape, np.int32), 0))


def _by_instance(ids: Ids, of_class: Image, tops: Indices) -> Division:
    """The instances of the class in each cutout."""
    cutout = np.repeat(np.arange(len(tops) - 1), np.diff(tops))[:, None]
    owned = np.where((of_class > 0) & (ids > 0), cutout * 2**16 + ids, 0)
    numbers = np.unique(owned[owned > 0])
    labels = np.where(owned > 0, np.searchsorted(numbers, owned) + 1, 0).astype(np.int32)
    return Division(*numbered(labels, len(numbers)))
