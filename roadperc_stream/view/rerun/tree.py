"""The transform tree as Rerun draws it: the car's frame of the results on top, and one parent for each frame."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
import rerun as rr

from roadperc_stream.core.datatypes import EGO, ODOM, OWN_ODOM, Transform
from roadperc_stream.input.assemble import ego_frame_of
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.view.rerun.entry import Entry, SceneState

TREE: Final = "/tf"
"""Below it each frame of the log has one entity, whichever topic places it: of two entities neither would hold."""


def new_edges(world: SceneState) -> Iterator[Entry]:
    """The edges that are not drawn yet as they are now."""
    for child, edge in ego_tree(world).items():
        if not _same(edge, world.edges.get(child)):
            world.edges[child] = edge
            yield edge_entry(TREE, edge)


def _same(edge: Transform, drawn: Transform | None) -> bool:
    if drawn is None or drawn.parent != edge.parent:
        return False
    return np.array_equal(drawn.parent_T_child, edge.parent_T_child)


def known_as(frame_id: str) -> str:
    """What a frame of the log is called: its own odom is not the one of the results, which starts with them."""
    return f"{ODOM} of the log" if frame_id == ODOM else frame_id


def of_odometry(edge: Transform) -> bool:
    """Whether an edge of the results says where the car is; the others join ego to the log's tree, as is done here."""
    return {edge.parent, edge.child} in ({EGO, ODOM}, {EGO, OWN_ODOM})


def ego_tree(world: SceneState) -> Mapping[str, Transform]:
    """The edges by child, as the chain reads them: the frame that it uses as ego is placed at ego.

    Without a mounting that is the front camera itself, as soon as a result says how high it was assumed to be.
    """
    camera, assumed = world.front, world.assumed_mounting
    tree = world.latched.tree
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
        if child != EGO  # odometry alone says where ego is
    }


def edge_entry(entity: str, edge: Transform) -> Entry:
    """An edge, at an entity named by its child."""
    rotation, translation = edge.parent_T_child[:3, :3], edge.parent_T_child[:3, 3]
    drawn = rr.Transform3D(translation=translation, mat3x3=rotation, parent_frame=edge.parent, child_frame=edge.child)
    return Entry(f"{entity}/{rr.escape_entity_path_part(edge.child)}", drawn)
