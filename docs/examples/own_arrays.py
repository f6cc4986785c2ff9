"""The chain on arrays of your own: a straight road drawn with numpy, seen from a moving car."""

import numpy as np

import roadperc_stream as rp

camera = rp.Camera("camera", width=640, height=480, fx=400, fy=400, cx=319.5, cy=239.5)
chain = rp.Chain(camera, tag_table="0.9.15")
ROAD, SIDEWALK, LINE, SKY, CAR = 1, 2, 24, 11, 14

rows, columns = np.mgrid[: camera.height, : camera.width]
with np.errstate(divide="ignore"):
    depth_m = np.where(rows > camera.cy, camera.fy * 1.5 / (rows - camera.cy), np.nan)  # a camera 1.5 m over the road
depth_m[depth_m > 60] = np.nan
depth_m[220:280, 300:340] = 15.0  # a car

for frame in range(5):
    lateral_m = -(columns - camera.cx) / camera.fx * depth_m + 0.02 * frame  # to the left; the car drifts to the right
    tags = np.full(camera.size, SKY, np.uint8)
    tags[np.abs(lateral_m) < 6] = SIDEWALK
    tags[np.abs(lateral_m) < 3.5] = ROAD
    tags[np.abs(np.abs(lateral_m) - 1.8) < 0.08] = LINE
    tags[220:280, 300:340] = CAR
    car = rp.Detection("car", rp.Box(x_min=300, y_min=220, x_max=340, y_max=280), score=0.9)  # of a detector, in pixels
    result = chain.step(frame * 50_000_000, depth_m=depth_m, tags=tags, detections=[car])
    left, right = result.lanes.side("left"), result.lanes.side("right")
    print(f"height {result.surface.camera_height_m:.3f} m, lane {left.offset_m:+.3f} {right.offset_m:+.3f} m", end=", ")
    print(f"{result.objects.nearest.detection.label} at {result.objects.nearest.distance_m:.1f} m")

print([str(reason) for reason in result.reasons()])
