"""Objects ahead of a moving car: the box of a narrow one moves by more than its width between two frames."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.tracker import ObjectsState, step
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera, mounting, rigid
from roadperc_stream.model import Box, Detection
from tests.analytic import PEDESTRIAN
from tests.scenes import scene_of

CAMERA = Camera("camera", 320, 240, 160.0, 160.0, 159.5, 119.5)
CFG = ObjectsConfig()
SIZE_M = 0.5, 1.75


def seen_person(x_m, y_m, noise):
    """Tags, depth and detection of an upright person at a place in the ego frame."""
    tags, depth = np.zeros(CAMERA.size, np.uint8), np.full(CAMERA.size, 90.0, np.float32)
    columns = 159.5 - 160.0 * (y_m + SIZE_M[0] * np.array([0.5, -0.5])) / x_m
    rows = 119.5 + 160.0 * (1.4 - np.array([SIZE_M[1], 0.0])) / x_m
    (x0, x1), (y0, y1) = (np.rint(c + 0.5).clip(0, limit) for c, limit in ((columns, 320), (rows, 240)))
    part = slice(int(y0), int(y1)), slice(int(x0), int(x1))
    tags[part], depth[part] = PEDESTRIAN, x_m * noise
    return tags, depth, Detection("Pedestrian", Box(x0, y0, x1, y1), 1.0)


def impacts(rate_hz, speed_mps, across_mps, *, seed=0):
    """Estimated and true times to impact of a person in the path, from the third visible frame on.

    The detector misses every fifth frame, and there is no image.
    """
    rng, state, found = np.random.default_rng(seed), ObjectsState(), []
    step_m = speed_mps / rate_hz
    ego_T_camera = mounting(0.0, 0.0, 1.4)
    for k, x_m in enumerate(np.arange(min(38.0, 3.2 * speed_mps), 0.5 * speed_mps, -step_m)):
        impact_s = x_m / speed_mps
        tags, depth, person = seen_person(x_m, across_mps * (1.2 - impact_s), 1 + 0.003 * rng.normal())
        scene = scene_of(
            CAMERA,
            ego_T_camera,
            depth_m=depth,
            tags=tags,
            detections=() if k % 5 == 4 else (person,),
            stamp_ns=round((k + 1) * 1e9 / rate_hz),
        )
        motion = rigid(np.eye(3), np.array([step_m, 0.0, 0.0])) if k else None
        state, out = step(CFG, state, scene, None, motion)
        (item,) = out.objects
        if k >= 2 and abs(across_mps * (1.2 - impact_s)) < 1.0:
            found.append((item.time_to_impact_s, impact_s, item.track_id))
    return found


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("speed_mps", [5.0, 15.0, 25.0, 30.0])
@pytest.mark.parametrize("across_mps", [2.6, 0.0])
def test_a_person_in_the_path_has_a_time_to_impact_from_the_third_frame(rate_hz, speed_mps, across_mps):
    found = impacts(rate_hz, speed_mps, across_mps)
    assert found
    assert {name for _, _, name in found} == {"1"}
    assert [impact_s for impact_s, _, _ in found] == pytest.approx([true_s for _, true_s, _ in found], rel=0.25)
