"""The signature of each stage that the user can replace; mypy checks the built-in stages against it, too.

A stage is a callable, or a class that is called without arguments once per replay. It may declare ``State``, a frozen
dataclass with a default for each field. The chain passes the state after the last frame and keeps the returned one:
it is saved, and decoded for a continued or resumed replay. Without ``State`` the state is None. Stereo has no state.

A stage is pure: what it needs from earlier frames is in the state, never in ``self``. The arrays of its inputs are
read-only. It returns ``Absent(Reason(STAGE, "no_result", ("why",)))`` if it has no result. Random numbers come from
``rng``. Several threads may call a stage, one after the other.
"""

from typing import Protocol, TypeVar

import numpy as np

from roadperc_stream.chain.stages.objects.contact import GroundPlane
from roadperc_stream.config import LanesConfig, ObjectsConfig, OdometryConfig, StereoConfig, SurfaceConfig
from roadperc_stream.geometry import Camera, Float
from roadperc_stream.model import Absent, Image, Lanes, Mask, Objects, Odometry, StereoDepth, Surface
from roadperc_stream.model.frame import Frame

S = TypeVar("S")
"""The stage's ``State``."""


class StereoStage(Protocol):
    """Depth of a rectified or rectifiable pair, in the image of the left camera."""

    def __call__(
        self,
        cfg: StereoConfig,
        left: Camera,
        right: Camera,
        ego_T_left: Float,
        left_image: Image | None,
        right_image: Image | None,
        /,
    ) -> StereoDepth | Absent:
        """(H, W) float32 metres along z, NaN unknown; the images are (H, W) grey, None if they cannot be decoded."""


class SurfaceStage(Protocol[S]):
    """The road of a frame. The chain derives the drivable pixels from it.

    Make the result with ``Surface.of``. Its plane is in the frame of the front camera, or of the depth's camera. An own
    stage also decides which plane an image without depth has; the chain holds and assumes planes only for its own.
    """

    def __call__(
        self, cfg: SurfaceConfig, state: S, frame: Frame, rng: np.random.Generator, /
    ) -> tuple[S, Surface | Absent]:
        """The new state and the surface."""


class OdometryStage(Protocol[S]):
    """The car's motion. ``road`` is the road in the front camera's frame if its height is known, for the scale.

    The result is the pose ``odom_T_ego``. A ``tracked`` frame also has the ``step`` since the frame with the stamp
    ``since_ns``. The pose is the identity in a frame with ``frame.is_origin``. A lost frame has the last known pose.
    """

    def __call__(
        self, cfg: OdometryConfig, state: S, frame: Frame, road: Surface | None, rng: np.random.Generator, /
    ) -> tuple[S, Odometry | Absent]:
        """The new state and the motion."""


class LanesStage(Protocol[S]):
    """The boundaries of the ego lane, at most one for each side.

    ``road`` has its plane in the front camera's frame. ``drivable`` is (H, W). ``motion`` is that of the ego frame
    since the last frame, in metres, or lost; None if it is unknown.
    """

    def __call__(
        self,
        cfg: LanesConfig,
        state: S,
        frame: Frame,
        road: Surface | Absent,
        drivable: Mask | Absent,
        motion: Odometry | None,
        /,
    ) -> tuple[S, Lanes | Absent]:
        """The new state and the lanes."""


class ObjectsStage(Protocol[S]):
    """The objects of a frame, kept and dropped.

    ``last_T_this`` is the (4, 4) motion of ego, metres, None unknown; ``ground`` is the road in a frame without depth.
    """

    def __call__(
        self,
        cfg: ObjectsConfig,
        state: S,
        frame: Frame,
        lanes: Lanes | None,
        last_T_this: Float | None,
        ground: GroundPlane | None,
        /,
    ) -> tuple[S, Objects | Absent]:
        """The new state and the objects."""
