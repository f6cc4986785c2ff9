"""Closing speed and time to impact, with their standard deviations, as far as they are known."""

from dataclasses import replace
from math import sqrt

from roadperc_stream.chain.stages.objects.rate_filter import RateFilter
from roadperc_stream.chain.stages.objects.tracking import ObjectTrack
from roadperc_stream.core.config import ObjectsConfig
from roadperc_stream.core.datatypes import Object


def with_motion(cfg: ObjectsConfig, item: Object, track: ObjectTrack) -> Object:
    """An object with its track's id, and its closing speed and time to impact by the track's distances.

    The speed is that of the distance to the camera, positive when coming nearer. A speed that is not known well is
    not given. A time to impact is given only for what surely comes nearer, and not while the distances contradict
    the filtered one: either may be another object's.
    """
    named = replace(item, track_id=track.id)
    distance = track.distance_m
    if distance is None or sqrt(distance.rate_var) > cfg.max_speed_std_mps:
        return named
    closing, std = -distance.rate, sqrt(distance.rate_var)
    named = replace(named, closing_speed_mps=closing, closing_speed_std_mps=std)
    contradicted = track.rival_m is not None or distance.value <= 0
    if contradicted or closing < cfg.min_closing_mps or closing < cfg.min_closing_sigmas * std:
        return named
    return replace(
        named, time_to_impact_s=distance.value / closing, time_to_impact_std_s=_time_to_impact_std_s(distance)
    )


def _time_to_impact_std_s(distance: RateFilter) -> float:
    """First-order propagation through distance / closing speed, their covariance included."""
    by_distance = -1 / distance.rate
    by_rate = distance.value / distance.rate**2
    variance = (
        by_distance**2 * distance.value_var
        + 2 * by_distance * by_rate * distance.cross_var
        + by_rate**2 * distance.rate_var
    )
    return sqrt(max(variance, 0.0))
