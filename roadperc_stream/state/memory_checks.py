"""Whether what a state says of the chain's memory is what the chain can have remembered."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from sys import float_info
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.lanes.class_history import MOST_OBSERVED
from roadperc_stream.chain.stages.objects.rate_filter import RateFilter
from roadperc_stream.chain.stages.objects.template import LARGEST_PX
from roadperc_stream.chain.stages.objects.tracker import MOST_TRACKS, ObjectsState
from roadperc_stream.chain.stages.objects.tracking import ObjectTrack
from roadperc_stream.chain.stages.odometry import OdometryState
from roadperc_stream.chain.stages.odometry.camera_pitch import CameraPitch
from roadperc_stream.chain.stages.surface import SurfaceState
from roadperc_stream.chain.step import ChainState
from roadperc_stream.core.config import LimitsConfig, OdometryConfig, ReplayConfig
from roadperc_stream.core.datatypes import Image
from roadperc_stream.core.datatypes.arrays import read_only
from roadperc_stream.core.geometry import Camera, Float
from roadperc_stream.core.time import END_OF_TIME_NS
from roadperc_stream.output.writing import TRAJECTORY_POSES, Shown

_ROUNDING: Final = 1e-6
_STEEPEST: Final = np.pi / 2
_LARGEST: Final = 1e30
"""No length, angle, pixel or variance is as large; the fourth power of one that is is still a number."""


def require_chain(chain: ChainState, cfg: ReplayConfig, most_objects: int) -> None:
    """Check what the stages remember.

    Args:
        chain: of a replay with ``cfg``.
        cfg: its settings.
        most_objects: how many objects it can have numbered.

    Raises:
        ValueError: no chain can remember it.
    """
    if chain.stamp_ns is not None and not 0 <= chain.stamp_ns < END_OF_TIME_NS:
        raise ValueError("a time out of its range")
    _require_earlier(chain, -1 if chain.stamp_ns is None else chain.stamp_ns)
    _require_surface(chain.surface)
    _require_odometry(chain.odometry, cfg.odometry, cfg.limits)
    _require_objects(chain.objects, most_objects)
    _require_finite(chain.lanes, _LARGEST)
    _require_finite(chain.objects)
    _require_finite((chain.objects.path, chain.objects.arc), _LARGEST)
    for side in (chain.lanes.left, chain.lanes.right):
        if side is not None:
            _require_covariance(side.track.covariance)
            if max(len(side.inside.observations), len(side.outside.observations)) > MOST_OBSERVED:
                raise ValueError(f"classes beside a boundary: expected {MOST_OBSERVED} at most")


def require_shown(shown: Shown) -> None:
    """Check what later frames show.

    Raises:
        ValueError: none can.
    """
    if len(shown.trajectory) > TRAJECTORY_POSES:
        raise ValueError(f"trajectory of {len(shown.trajectory)} poses: expected {TRAJECTORY_POSES} at most")
    for odom_T_ego in shown.trajectory:
        require_transform(odom_T_ego)
    if shown.first_ns is not None and not 0 <= shown.first_ns < END_OF_TIME_NS:
        raise ValueError("a time out of its range")


def require_transform(matrix: Float) -> None:
    """Check a rigid transform.

    Raises:
        ValueError: it is none.
    """
    read_only(matrix, np.float64, (4, 4), "transform")
    rotation: NDArray[np.float64] = matrix[:3, :3]
    is_whole = bool(np.isfinite(matrix).all()) and float(np.abs(rotation).max()) < 2
    if not (is_whole and np.allclose(rotation @ rotation.T, np.eye(3), atol=_ROUNDING) and np.linalg.det(rotation) > 0):
        raise ValueError("a transform that is none")


def _require_surface(surface: SurfaceState) -> None:
    _require_finite(surface, _LARGEST)
    normal = (0.0, 0.0, 1.0) if surface.ego_plane is None else surface.ego_plane.normal
    if surface.driven_m < 0 or abs(np.linalg.norm(normal) - 1.0) > _ROUNDING:
        raise ValueError("a plane that is none")


def _require_odometry(odometry: OdometryState, cfg: OdometryConfig, limits: LimitsConfig) -> None:
    require_transform(odometry.odom_T_ego)
    if odometry.pitch is not None:
        _require_pitch(odometry.pitch)
    keyframe, last = odometry.keyframe, odometry.last
    if keyframe is None or last is None:
        return
    require_transform(keyframe.odom_T_camera)
    _require_finite(keyframe.camera)
    _require_finite((last.velocity, last.influence, last.length_variance, last.speed_variance), _LARGEST)
    if min(last.length_variance, last.speed_variance or 0.0) < 0:
        raise ValueError("a variance that is none")
    _require_image_of(keyframe.camera, keyframe.grey, limits)
    landmarks = keyframe.landmarks
    features = landmarks.features
    pulls = () if last.influence is None else (last.influence,)
    parts = (features.px, features.descriptors, landmarks.points_m, landmarks.slope, last.found_px, *pulls)
    if len({len(part) for part in parts}) > 1:
        raise ValueError(f"landmarks of {', '.join(str(len(part)) for part in parts)} points")
    if len(features.px) > cfg.max_points:
        raise ValueError(f"{len(features.px)} landmarks: expected odometry.max_points {cfg.max_points} at most")


def _require_pitch(pitch: CameraPitch) -> None:
    _require_finite(pitch)
    if pitch.variance < 0 or abs(pitch.offset) > _STEEPEST:
        raise ValueError("a pitch that is none")


def _require_image_of(camera: Camera, grey: Image, limits: LimitsConfig) -> None:
    read_only(grey, np.uint8, (camera.height, camera.width), "keyframe")
    if not 0 < grey.size <= limits.image_pixels:
        megapixels = f"expected limits.image_megapixels {limits.image_megapixels:g} at most"
        raise ValueError(f"a keyframe of {camera.width} x {camera.height} pixels: {megapixels}")


def _require_objects(objects: ObjectsState, most_objects: int) -> None:
    if not 1 <= objects.next_number <= most_objects:
        raise ValueError(f"object {objects.next_number}")
    if len(objects.tracks) > MOST_TRACKS:
        raise ValueError(f"{len(objects.tracks)} tracks: expected {MOST_TRACKS} at most")
    numbers = {track.number for track in objects.tracks}
    if len(numbers) < len(objects.tracks) or any(not 1 <= number < objects.next_number for number in numbers):
        raise ValueError("tracks of numbers that are none")
    for track in objects.tracks:
        if track.template is not None:
            _require_template(track.template.grey)
        _require_approach(track)
        for motion in (track.x_px, track.y_px, track.distance_m, track.rival_m, track.right_m, track.left_m):
            if motion is not None:
                _require_filter(motion)


def _require_approach(track: ObjectTrack) -> None:
    """Check what divides something in the prediction of a distance."""
    _require_finite((track.ego_rate, track.nearest_ray, track.jitter), _LARGEST)
    rate, ray, jitter = track.ego_rate, track.nearest_ray, track.jitter
    if rate is not None and rate.dt_s <= 0:
        raise ValueError("a distance's rate over no time")
    if ray is not None and (len(ray) != len("xyz") or ray[-1] != 1):
        raise ValueError("a direction that is none")
    if jitter is not None and min(jitter.weight, jitter.variance) < 0:
        raise ValueError("a jitter that is none")


def _require_template(grey: Image) -> None:
    if not grey.size or max(grey.shape) > LARGEST_PX:
        raise ValueError(f"a template of {grey.shape[1]} x {grey.shape[0]} pixels: expected 1 to {LARGEST_PX} a side")


def _require_filter(motion: RateFilter) -> None:
    _require_finite(motion, _LARGEST)
    _require_covariance(np.array(((motion.value_var, motion.cross_var), (motion.cross_var, motion.rate_var))))


def _require_covariance(covariance: Float) -> None:
    """Check a covariance, but for what rounding may have left."""
    _require_finite(covariance)
    scale = float(np.abs(covariance).max())
    if float(np.linalg.eigvalsh((covariance + covariance.T) / 2).min()) < -_ROUNDING * scale:
        raise ValueError("a covariance that is none")
    if float(np.abs(covariance - covariance.T).max()) > _ROUNDING * scale:
        raise ValueError("a covariance that is none")


def _require_finite(value: Any, most: float = float_info.max) -> None:
    """Check all numbers below a value, and that none is larger than ``most``."""
    for _, number in _leaves("", value):
        if isinstance(number, float | np.ndarray) and not (np.abs(number) <= most).all():
            raise ValueError("a number that is not finite, or far too large")


def _require_earlier(value: Any, last_ns: int) -> None:
    """Check that all times below a value are up to ``last_ns``."""
    for name, number in _leaves("", value):
        if name.endswith("_ns") and isinstance(number, int) and not 0 <= number <= last_ns:
            raise ValueError("a time out of its range")


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """What is below a value, with the name of the field that holds it."""
    if is_dataclass(value):
        for field in fields(value):
            yield from _leaves(field.name, getattr(value, field.name))
    elif isinstance(value, tuple):
        for item in value:
            yield from _leaves(name, item)
    else:
        yield name, value
