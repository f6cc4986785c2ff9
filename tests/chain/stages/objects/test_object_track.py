"""The speed of one track against known motions of its object."""

from math import hypot

import numpy as np

from roadperc_stream.chain.stages.objects import object_track
from roadperc_stream.chain.stages.objects.place import sighting
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera
from roadperc_stream.model import Box, Detection, Object

CFG = ObjectsConfig()
CAMERA = Camera("camera", 640, 480, fx=400.0, fy=400.0, cx=320.0, cy=240.0)
STEP_NS = 100_000_000


def follow(places_m, noise_m, std_m):
    """The track of a car of 2 m by 1.5 m after each of the places, (right, ahead), while the camera stands."""
    rng, track, tracks = np.random.default_rng(3), None, []
    for k, (right_m, ahead_m) in enumerate(places_m, 1):
        x, y = CAMERA.cx + CAMERA.fx * right_m / ahead_m, CAMERA.cy + CAMERA.fy * 0.5 / ahead_m
        half = CAMERA.fx / ahead_m
        box = Box(x - half, y - 0.75 * half, x + half, y + 0.75 * half)
        distance_m = hypot(right_m, ahead_m) + rng.normal(0.0, noise_m)
        item = Object(Detection("Car", box, 1.0), kept=True, distance_m=distance_m, distance_std_m=std_m)
        if track is None:
            track = object_track.start(CFG, 1, item, box, k * STEP_NS)
        else:
            track = object_track.predict(CFG, track, k * STEP_NS, np.eye(4))
            track = object_track.detected(CFG, track, item, box)
        track = object_track.seen_at(track, sighting(CAMERA, box, distance_m, std_m))
        tracks.append(track)
    return tracks


def test_the_speed_of_a_car_that_crosses_the_road_does_not_lag():
    """At 12 m/s across, 10 m ahead, the distance's rate changes by up to 14 m/s within a second."""
    across_m = np.arange(-9.0, 4.0, 1.2)
    tracks = follow([(x, 10.0) for x in across_m], noise_m=0.02, std_m=0.1)
    true_mps = across_m * 12.0 / np.hypot(across_m, 10.0)
    errors = [track.distance_m.rate - true for track, true in zip(tracks, true_mps, strict=True)]
    assert np.abs(errors[4:]).max() < 1.0
