"""The state between messages and the transform tree, as entries for Rerun."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import rerun as rr

from roadperc_stream.geometry import Camera, Float
from roadperc_stream.input.assemble import ego_frame_of
from roadperc_stream.input.decoding import Payload
from roadperc_stream.input.replaced import replaced
from roadperc_stream.input.transforms import NOTHING_LATCHED, LatchedState, TransformTree
from roadperc_stream.model import EGO, ODOM, OWN_ODOM, Transform
from roadperc_stream.model.tag_tables import Colour

_CALIBRATIONS: Final = {"left": "left_calibration", "depth": "depth_calibration"}


@dataclass(frozen=True)
class Entry:
    """An archetype of an entity; ``frame`` is its coordinate frame, empty for none."""

    entity: str
    archetype: rr.AsComponents
    frame: str = ""


@dataclass
class SceneState:
    """Cameras and transforms, which hold until replaced, and the edges and texts that were drawn last."""

    reference: str = "image"
    """The role whose messages are the frames; results belong to its camera."""
    given: LatchedState = NOTHING_LATCHED
    """The cameras and mountings that the replay used instead of those of the log."""
    of_log: LatchedState = field(default_factory=LatchedState)
    assumed_mounting: Float | None = None
    """ego_T_camera of a front camera without transforms."""
    edges: dict[str, Transform] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    planes: dict[str, tuple[str, Camera]] = field(default_factory=dict)
    """The entity that draws each image plane, and its camera: Rerun takes a frame from one entity only."""

    @property
    def latched(self) -> LatchedState:
        """The cameras and transforms that the replay used."""
        return replaced(self.of_log, self.given, self.reference)

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
        """Coordinate frame of a role's pixels, from its calibration if it has one."""
        camera = self.camera_of(role)
        return self.plane_of(camera) if camera else image_plane(frame_id)

    def plane_of(self, camera: Camera) -> str:
        """The image plane of a camera, which all cameras with its frame and its pixels share."""
        drawn = (name for name, (_, other) in self.planes.items() if _pixels(other) == _pixels(camera))
        return next(drawn, image_plane(camera.frame_id))

    def plane_to_draw(self, entity: str, camera: Camera) -> str | None:
        """The image plane that an entity draws for its camera; None if another entity draws it already."""
        own = next((name for name, (owner, _) in self.planes.items() if owner == entity), None)
        plane = own or self.plane_of(camera)
        if not own and plane in self.planes:
            if _pixels(self.planes[plane][1]) == _pixels(camera):
                return None
            plane = f"{plane} of {entity}"
        self.planes[plane] = entity, camera
        return plane

    def knows(self, frame_id: str) -> bool:
        """Whether the log's transforms contain this frame."""
        return self.latched.tree.knows(frame_id)

    def latch(self, role: str, payload: Payload) -> None:
        """Update a calibration or transforms; leaves out edges that close a loop, like the chain."""
        edges = tuple(part for part in payload if isinstance(part, Transform)) if isinstance(payload, tuple) else ()
        looping = self.of_log.tree.looping(edges)
        kept = tuple(edge for edge in edges if edge.child not in looping)
        self.of_log = self.of_log.updated(role, kept if edges else payload)


def _pixels(camera: Camera) -> tuple[object, ...]:
    return camera.frame_id, camera.size, camera.K.tobytes()


def image_plane(frame_id: str) -> str:
    """Coordinate frame of a camera's pixels, named as Rerun's importer names it."""
    return f"{frame_id}_image_plane"


def annotation_context(names: Iterable[str], colours: Iterable[Colour]) -> rr.AnnotationContext:
    """Names and colours of class ids 0, 1, 2, ..."""
    named = zip(names, colours, strict=True)
    return rr.AnnotationContext([rr.AnnotationInfo(i, name, colour) for i, (name, colour) in enumerate(named)])


TREE: Final = "/tf"
"""Parent of one entity per frame. Rerun would mix the transforms of two entities."""


def new_edges(state: SceneState) -> Iterator[Entry]:
    """Draw the edges that changed since they were drawn last."""
    for child, edge in ego_tree(state).items():
        drawn = state.edges.get(child)
        same_parent = drawn is not None and drawn.parent == edge.parent
        if drawn is None or not same_parent or not np.array_equal(drawn.parent_T_child, edge.parent_T_child):
            state.edges[child] = edge
            yield edge_entry(TREE, edge)


def known_as(frame_id: str) -> str:
    """The name of a log's frame in Rerun. The log's odom differs from the odom of the results."""
    return f"{ODOM} of the log" if frame_id == ODOM else frame_id


def of_odometry(edge: Transform) -> bool:
    """Whether an edge of the results is the pose of the car; the others connect ego and the log's tree."""
    return {edge.parent, edge.child} in ({EGO, ODOM}, {EGO, OWN_ODOM})


def ego_tree(state: SceneState) -> Mapping[str, Transform]:
    """The edges by child, as the chain uses them: the frame that it uses as ego is placed at ego.

    Without a mounting, the front camera is placed below ego as soon as a result gives its assumed height.
    """
    camera, assumed = state.front, state.assumed_mounting
    tree = state.latched.tree
    own = ego_frame_of(tree, camera) if camera else None
    if camera and own is None and assumed is not None:
        return _below_ego(tree, camera.frame_id, Transform(EGO, camera.frame_id, assumed))
    return _below_ego(tree, own or EGO, Transform(EGO, own or EGO, np.eye(4)))


def _below_ego(tree: TransformTree, frame: str, ego_T_frame: Transform) -> Mapping[str, Transform]:
    """The tree with a frame on top, and that frame below ego."""
    edges = dict(tree.rooted_at(frame).edges) | {frame: ego_T_frame}
    return {
        child: Transform(known_as(edge.parent), known_as(child), edge.parent_T_child)
        for child, edge in edges.items()
        if child != EGO  # only odometry places ego
    }


def edge_entry(entity: str, edge: Transform) -> Entry:
    """An edge, at an entity named by its child."""
    rotation, translation = edge.parent_T_child[:3, :3], edge.parent_T_child[:3, 3]
    drawn = rr.Transform3D(translation=translation, mat3x3=rotation, parent_frame=edge.parent, child_frame=edge.child)
    return Entry(f"{entity}/{rr.escape_entity_path_part(edge.child)}", drawn)
