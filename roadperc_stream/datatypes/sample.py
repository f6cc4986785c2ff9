"""A frame with its truth beside it, so that truth cannot leak into perception."""

from dataclasses import dataclass

import numpy as np

from roadperc_stream.datatypes.arrays import read_only
from roadperc_stream.datatypes.frame import DepthImage, Frame, TagImage
from roadperc_stream.datatypes.results import Lanes, Objects, Surface
from roadperc_stream.geometry import Float


@dataclass(frozen=True)
class Truth:
    """What is known to be true of a frame; the chain never sees it."""

    odom_T_ego: Float | None = None
    surface: Surface | None = None
    lanes: Lanes | None = None
    objects: Objects | None = None
    depth: DepthImage | None = None
    segmentation: TagImage | None = None

    def __post_init__(self) -> None:
        if self.odom_T_ego is not None:
            read_only(self.odom_T_ego, np.float64, (4, 4), "odom_T_ego")


@dataclass(frozen=True)
class Sample:
    """One instant of a log, as ``sync`` put it together."""

    index: int
    log_time_ns: int
    frame: Frame
    truth: Truth
    missing: tuple[str, ...] = ()
    skew_ns: int | None = None
