"""Warnings about a segmentation that cannot be a road, such as that of a network with the wrong input."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from roadperc_stream.model import Image
from roadperc_stream.model.tag_tables import TagTable

FRAMES: Final = 20
ROAD: Final = "road"
_LEAST_ROAD: Final = 0.3
_MOST_ABOVE: Final = 0.3
_PATCH_ROWS: Final = (0.65, 0.9)
_PATCH_COLUMNS: Final = (1 / 3, 2 / 3)
_ABOVE: Final = 0.4


@dataclass
class RoadCheck:
    """The share of road before the car and in the upper part of the image, over the first frames."""

    before: list[float] = field(default_factory=list)
    above: list[float] = field(default_factory=list)

    def add(self, table: TagTable, tags: Image) -> None:
        """Count the road in the (H, W) tags of one more frame; a table without a road has no warnings."""
        if len(self.before) < FRAMES and table.tags_of((ROAD,)):
            road = table.lookup((ROAD,))[tags]
            rows, columns = road.shape
            patch_rows, patch_columns = _span(_PATCH_ROWS, rows), _span(_PATCH_COLUMNS, columns)
            self.before.append(float(road[patch_rows, patch_columns].mean()))
            self.above.append(float(road[: max(int(_ABOVE * rows), 1)].mean()))

    def warnings(self, name: str) -> Iterator[str]:
        """Yield the warnings; ``name`` is the network's file."""
        found = (
            (self.before, _LEAST_ROAD, 1.0, "of the road before the car"),
            (self.above, 0.0, _MOST_ABOVE, f"of the image's upper {_ABOVE:.0%}"),
        )
        for shares, least, most, what in found:
            if shares and not least <= (share := float(np.mean(shares))) <= most:
                yield (
                    f"{name}: {share:.0%} {what} is drivable in the first {len(shares)} frames, expected {least:.0%} "
                    f"to {most:.0%}; look at the picture of roadperc-infer --check"
                )


def _span(shares: tuple[float, float], length: int) -> slice:
    return slice(int(shares[0] * length), max(int(shares[1] * length), int(shares[0] * length) + 1))
