"""The camera's pitch against a road without depth: shown by the motion, else by the vanishing point of the lanes."""

from typing import Final

import numpy as np

from roadperc_stream.chain.stages.lanes import lines
from roadperc_stream.chain.stages.odometry.camera_pitch import LANES_STEEPEST, LINES_STD, pitch_of_segments
from roadperc_stream.chain.stages.odometry.keyframes import OdometryState
from roadperc_stream.chain.stages.surface.road import KnownPitch, SurfaceState
from roadperc_stream.config import ReplayConfig
from roadperc_stream.geometry.ground import part
from roadperc_stream.model.frame import Frame
from roadperc_stream.system.time import NS_PER_S

_ROWS: Final = 240
"""Least rows of the reduced image in which lines are searched: enough for a tenth of a degree."""
_FEWEST_LINES: Final = 2
_MOST_LINES: Final = 40
_SIGMAS: Final = 3.0
"""Least pitch in standard deviations; a smaller one does not contradict the mounting."""
_DRIVE_S: Final = 1.0
"""Longest time between frames of a drive; odometry may match the similar roads of two single images."""


def known_pitch(
    cfg: ReplayConfig,
    surfaces: SurfaceState | bytes,
    odometry: OdometryState | bytes,
    frame: Frame,
    last_ns: int | None = None,
) -> KnownPitch | None:
    """The pitch beyond the mounting; None if neither motion nor lanes show it, or if the mounting's is exact.

    The lanes are searched only in a frame without any other plane, as in single images. ``last_ns`` is the stamp of the
    last frame.
    """
    shown = None if isinstance(odometry, bytes) or odometry.pitch is None else odometry.pitch
    by_motion = KnownPitch(shown.offset, shown.variance, "the motion") if shown and shown.measured else None
    is_drive = last_ns is None or (frame.stamp_ns - last_ns) / NS_PER_S <= _DRIVE_S
    if by_motion is not None and by_motion.variance < LINES_STD**2 and is_drive:
        return by_motion
    has_plane = frame.raw_depth_m is not None or isinstance(surfaces, bytes) or surfaces.ego_plane is not None
    if has_plane or cfg.odometry.pitch_std_deg == 0:
        return by_motion
    return _by_lanes(cfg, frame) or by_motion


def _by_lanes(cfg: ReplayConfig, frame: Frame) -> KnownPitch | None:
    """The pitch by the long lines of the separators on the road, searched in every n-th pixel."""
    n = max(frame.camera.height // _ROWS, 1)
    labels = frame.labels(cfg.lanes.separators), frame.labels(cfg.surface.classes)
    separators, road = (None if found is None else np.ascontiguousarray(found[::n, ::n]) for found in labels)
    rows = None if road is None else lines.road_rows(road.view(bool))
    if separators is None or road is None or rows is None:
        return None
    visible = lines.visible_share(*rows, len(road))
    proposals = lines.propose(cfg.lanes, lines.edges_of(cfg.lanes, separators), visible)
    found = lines.on_road(proposals, road.view(bool))
    longest = np.argsort(-np.linalg.norm(found[:, 2:] - found[:, :2], axis=1), kind="stable")[:_MOST_LINES]
    camera = part(frame.camera, n, n)
    pitch = pitch_of_segments(camera, frame.ego_T_camera, found[longest], _FEWEST_LINES, LANES_STEEPEST)
    if pitch is None or abs(pitch[0]) < _SIGMAS * np.sqrt(pitch[1]):
        return None
    return KnownPitch(*pitch, "the lanes' vanishing point")
