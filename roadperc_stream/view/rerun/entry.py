"""What is logged to Rerun, and what holds from one message to the next."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

import rerun as rr

from roadperc_stream.core.datatypes import Transform
from roadperc_stream.core.geometry import Camera, Float
from roadperc_stream.core.semantics import Colour
from roadperc_stream.input.decoding import Payload
from roadperc_stream.input.latched import LatchedState
from roadperc_stream.input.stream import Stamped

_CALIBRATIONS: Final = {"left": "left_calibration", "depth": "depth_calibration"}


@dataclass(frozen=True)
class Entry:
    """One archetype of one entity; ``frame`` is the coordinate frame it is drawn in, empty where it has none."""

    entity: str
    archetype: rr.AsComponents
    frame: str = ""


@dataclass
class SceneState:
    """What holds until replaced: cameras and transforms, and what of them and of the words is drawn already."""

    reference: str = "image"
    """The role whose messages make the frames: the results are those of its camera."""
    latched: LatchedState = field(default_factory=LatchedState)
    assumed_mounting: Float | None = None
    """ego_T_camera of a front camera that the log does not place."""
    edges: dict[str, Transform] = field(default_factory=dict)
    words: dict[str, str] = field(default_factory=dict)

    @property
    def front(self) -> Camera | None:
        """The camera of the results."""
        return self.camera_of(self.reference)

    def camera_of(self, role: str) -> Camera | None:
        """The camera of an image's role; left and depth images without calibration are the front camera's."""
        cameras = self.latched.cameras
        if role == "right":
            return cameras.get("right_calibration")
        return cameras.get(_CALIBRATIONS.get(role, "calibration")) or cameras.get("calibration")

    def image_frame(self, role: str, frame_id: str) -> str:
        """Coordinate frame of a role's pixels: that of its calibration, where there is one."""
        camera = self.camera_of(role)
        return image_plane(camera.frame_id if camera else frame_id)

    def knows(self, frame_id: str) -> bool:
        """Whether the log's transforms place a frame, or others below it."""
        return self.latched.tree.knows(frame_id)

    def latch(self, role: str, payload: Payload) -> None:
        """Take in a calibration or transforms; edges that close a loop are left out, as the chain leaves them out."""
        kept, _ = self.latched.split_loops(Stamped(role, 0, 0, payload))
        self.latched = self.latched.updated(kept)


def image_plane(frame_id: str) -> str:
    """Coordinate frame of a camera's pixels: the name that Rerun's own importer gives it."""
    return f"{frame_id}_image_plane"


def annotation_context(names: Iterable[str], colours: Iterable[Colour]) -> rr.AnnotationContext:
    """Names and colours of class ids 0, 1, 2, ..."""
    named = zip(names, colours, strict=True)
    return rr.AnnotationContext([rr.AnnotationInfo(i, name, colour) for i, (name, colour) in enumerate(named)])
