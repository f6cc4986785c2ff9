"""A log's frames with their results, in ten lines."""

import numpy as np

import roadperc_stream as rp

for frame in rp.frames("logs/sample.mcap", max_frames=5):
    lanes, objects = frame.result.lanes, frame.result.objects
    near = objects.nearest
    drivable = np.mean(frame.result.drivable)
    print(frame.metrics.frame, f"{drivable:.0%} drivable,", lanes.side("left").status, end=", ")
    print(f"{near.detection.label} at {near.distance_m:.1f} m" if near else "nothing near")
