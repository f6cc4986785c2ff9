"""One boundary from frame to frame: predicted, measured again, held, or begun."""

from collections.abc import Iterator
from dataclasses import replace

from roadperc_stream.chain.stages.lanes import tracking
from roadperc_stream.chain.stages.lanes.curves import Curve
from roadperc_stream.chain.stages.lanes.memory import TrackedBoundary
from roadperc_stream.chain.stages.lanes.observe import Observation
from roadperc_stream.chain.stages.lanes.sides import outward
from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.datatypes import Odometry, Side

JUDGED_AT_M = 10.0
"""How far ahead a boundary must be known, as well as at the car."""
_SAME_M = 0.6
"""A line so close to the other boundary's prediction is that boundary, both edges of a double line included."""


def predicted(
    cfg: LanesConfig, before: TrackedBoundary | None, moved: Odometry | None, stamp_ns: int
) -> TrackedBoundary | None:
    """A boundary at this frame's time, before the frame is looked at."""
    if before is None:
        return None
    return replace(before, track=tracking.predict(cfg, before.track, stamp_ns, moved))


def followed(
    cfg: LanesConfig,
    side: Side,
    before: TrackedBoundary | None,
    other: TrackedBoundary | None,
    observation: Observation | None,
    stamp_ns: int,
) -> TrackedBoundary | None:
    """The boundary as the frame has it; None where there is none yet or it has not been measured for too long.

    Args:
        cfg: thresholds.
        side: which one.
        before: its prediction.
        other: that of the other side's.
        observation: what the frame shows; None without tags.
        stamp_ns: the frame's.
    """
    observed = observation.boundaries.get(side) if observation else None
    curve = observed.curve if observed else None
    if curve is not None and observation is not None and other is not None and _is_other(curve, other):
        curve = observation.curve_beyond(cfg, side, outward(side) * other.offset_m + cfg.min_width_m)
    if before is not None:
        for candidate in _candidates(cfg, side, before, observation, curve):
            updated = tracking.update(cfg, before.track, candidate.state, candidate.covariance)
            if updated is not None and observation is not None:
                return measured(cfg, replace(before, track=updated), side, candidate, observation)
        if not tracking.expired(cfg, before.track):
            return before
    if observation is None or curve is None or not curve.is_sure:
        return None
    return begun(cfg, side, curve, observation, stamp_ns)


def begun(cfg: LanesConfig, side: Side, curve: Curve, observation: Observation, stamp_ns: int) -> TrackedBoundary:
    """A new boundary from what the frame shows."""
    track = tracking.start(curve.state, curve.covariance, stamp_ns)
    return measured(cfg, TrackedBoundary(track, curve.reach_m), side, curve, observation)


def measured(
    cfg: LanesConfig, tracked: TrackedBoundary, side: Side, curve: Curve, observation: Observation
) -> TrackedBoundary:
    """The boundary with this frame's curve and the classes on either side of it."""
    inside, outside = observation.classes_beside(side, curve)
    stamp_ns = tracked.track.stamp_ns
    now = replace(
        tracked,
        reach_m=curve.reach_m,
        inside=tracked.inside.add(cfg, stamp_ns, inside),
        outside=tracked.outside.add(cfg, stamp_ns, outside),
    )
    return judged(cfg, now)


def judged(cfg: LanesConfig, tracked: TrackedBoundary) -> TrackedBoundary:
    """The boundary, and whether it is known well enough to be given."""
    return replace(tracked, is_sure=tracking.std_at(tracked.track, least_known_m(tracked)) <= cfg.max_std_m)


def least_known_m(tracked: TrackedBoundary) -> float:
    """How far ahead, at the car or ``JUDGED_AT_M``, the boundary is known the less well."""
    return max(0.0, JUDGED_AT_M, key=lambda x_m: tracking.std_at(tracked.track, x_m))


def _is_other(curve: Curve, other: TrackedBoundary) -> bool:
    """Whether a line is the other side's boundary: while it is crossed the car has it on both sides."""
    return abs(float(curve.state[0]) - other.offset_m) < _SAME_M


def _candidates(
    cfg: LanesConfig, side: Side, before: TrackedBoundary, observation: Observation | None, curve: Curve | None
) -> Iterator[Curve]:
    """What may be the boundary: the edges along the prediction, then the closest line's curve.

    The dashes in sight are often too short for a Hough line, and the closest line is then one farther out. A clear line
    closer than the prediction, though, contradicts it: then edges along the prediction are no evidence.
    """
    closer = curve is not None and outward(side) * (before.offset_m - float(curve.state[0])) > _SAME_M
    if curve is not None and closer and curve.is_clear:
        yield curve
        return
    along = None if observation is None else observation.curve_along(cfg, side, before.track.state)
    if along is not None:
        yield along
    if curve is not None:
        yield curve
