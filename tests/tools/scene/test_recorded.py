"""Compare rendered scenarios with recorded ones, since all accuracy figures depend on the renderer.

After an intended change run ``pytest tests/tools/scene/test_recorded.py --force-regen``.
"""

import json

import cv2
import numpy as np
import pytest

from roadperc_stream.tools.carla_dump.point_files import load_points
from roadperc_stream.tools.scene.job import render_dump
from roadperc_stream.tools.scene.options import RenderOptions
from tests import summaries

SMALL = {"width": 64, "height": 64, "seconds": 5.0, "rate_hz": 0.4}
SCENARIOS = {
    "bend": {"scene": "bend", "seed": 3},
    "hill": {"scene": "hill", "seed": 1},
    "town": {"scene": "town", "lidar": True},
    "far-in-town": {"scene": "town", "speed_mps": 40.0, "seconds": 12.0, "rate_hz": 0.25, "seed": 2},
    "noise": {"scene": "town", "tag_noise": 0.05, "depth_noise": 0.02, "rgb_noise": 5.0, "drop": 0.2},
    "static": {"scene": "town", "static": True, "weave_m": 0.0},
    "queue": {"stop_and_go": True, "lane": "splits", "instances": True, "pitch_std_deg": 1.0} | SMALL,
    "turn": {"scene": "straight", "turn": "left", "whole_boxes": True, "mount": (1.0, 0.1, 1.5, 1.0, 2.0, 3.0)} | SMALL,
    "worn": {"worn_lines": (5.0, 25.0), "missing_lines": (25.0, 40.0), "bumps": True, "lead_brakes": True} | SMALL,
    "change": {"change_lane": "right", "change_back": True, "parked_rows": True, "path_truth": True} | SMALL,
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_is_rendered_as_recorded(name, tmp_path, ndarrays_regression):
    options = RenderOptions(**{"width": 160, "height": 120, "seconds": 3.0, "rate_hz": 1.0} | SCENARIOS[name])
    render_dump(tmp_path, options, force=False, on_frame=lambda: None)
    files = [path for path in sorted(tmp_path.rglob("*.*")) if path.is_file()]
    found = {str(path.relative_to(tmp_path)).replace("/", " "): summary_of(path) for path in files}
    summaries.check(ndarrays_regression, found)


def summary_of(file):
    if file.suffix == ".json":
        return summaries.of_document(json.loads(file.read_text()))
    if file.suffix == ".txt":
        return {"": (np.array(file.read_text().split()), summaries.EXACT)}
    if file.suffix == ".ply":
        return summaries.of_points(load_points(file).astype(float))
    pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)[..., :3]
    if file.parent.name == "segmentation":
        return summaries.of_tags(pixels[..., 2])
    if file.parent.name == "depth":
        b, g, r = np.moveaxis(pixels.astype(float), 2, 0)
        return summaries.of_depth((r + 256 * g + 65536 * b) / (2**24 - 1))
    return summaries.of_picture(pixels)
