"""What is rendered stays as it was recorded: every figure of an accuracy rests on it, so none of it changes unnoticed.

After a change that is meant, ``pytest tests/tools/scene/test_scene.py --force-regen`` records anew.
"""

import json
from collections import defaultdict

import cv2
import numpy as np
import pytest

from roadperc_stream.tools.carla_dump.point_files import load_points
from roadperc_stream.tools.scene.job import render_dump
from roadperc_stream.tools.scene.options import RenderOptions

BLOCK_PX = 8
DRIVES = {
    "straight": {"scene": "straight", "speed_mps": 20.0, "weave_m": 0.5},
    "bend": {"scene": "bend", "seed": 3},
    "hill": {"scene": "hill", "seed": 1},
    "town": {"scene": "town", "lidar": True},
    "far-in-town": {"scene": "town", "speed_mps": 40.0, "seconds": 12.0, "rate_hz": 0.25, "seed": 2},
    "noise": {"scene": "town", "tag_noise": 0.05, "depth_noise": 0.02, "rgb_noise": 5.0, "drop": 0.2},
    "static": {"scene": "town", "static": True, "weave_m": 0.0},
}
EXACT = {"rtol": 0.0, "atol": 0.0}
COUNTS = {"rtol": 0.0, "atol": 2.5}
"""Pixels of a class, and the like, where rounding differs between machines."""


@pytest.mark.parametrize("drive", DRIVES)
def test_a_drive_is_rendered_as_recorded(drive, tmp_path, ndarrays_regression):
    options = RenderOptions(width=160, height=120, **{"seconds": 3.0, "rate_hz": 1.0} | DRIVES[drive])
    render_dump(tmp_path / "dump", options, force=False, on_frame=lambda: None)
    measured, tolerances = {}, {}
    for file in sorted((tmp_path / "dump").rglob("*.*")):
        for name, (values, tolerance) in summary_of(file).items():
            key = f"{file.relative_to(tmp_path / 'dump')} {name}".replace("/", " ").strip()
            measured[key], tolerances[key] = values, tolerance or EXACT
    ndarrays_regression.check(measured, tolerances=tolerances, default_tolerance=EXACT)


def summary_of(file):
    """Arrays that say what a file holds, by name, each with how far it may be off."""
    if file.suffix == ".json":
        numbers, texts = leaves(json.loads(file.read_text()))
        moments = [[len(found), np.mean(found), np.std(found), min(found), max(found)] for found in numbers.values()]
        words = np.array([f"{path}: {' '.join(sorted(found))}" for path, found in texts.items()])
        return {
            "keys": (np.array(list(numbers)), None),
            "": (np.array(moments), {"atol": 1e-4}),
            "texts": (words, None),
        }
    if file.suffix == ".txt":
        return {"": (np.array(file.read_text().split()), None)}
    if file.suffix == ".ply":
        points = load_points(file).astype(float)
        sums = np.array([len(points), *points.mean(axis=0), *points.std(axis=0)])
        return {"": (sums, {"atol": 1e-3})}
    return picture(file)


def leaves(node, path="", found=None):
    """Numbers and texts of a JSON document, by their keys; elements of lists, and frames, are taken together."""
    numbers, texts = found = found or (defaultdict(list), defaultdict(list))
    if isinstance(node, dict):
        for key, value in node.items():
            leaves(value, f"{path}.{'*' if key.isdigit() else key}", found)
    elif isinstance(node, list):
        for value in node:
            leaves(value, f"{path}[]", found)
    elif isinstance(node, str) or node is None:
        texts[path].append(str(node))
    else:
        numbers[path].append(float(node))
    return numbers, texts


def picture(file):
    pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    kind = file.parent.name
    if kind == "segmentation":
        tags = pixels[..., 2]
        return {"": (np.array([blocks(tags == tag).sum(axis=2) for tag in np.unique(tags)]), COUNTS)}
    if kind == "depth":
        b, g, r = np.moveaxis(pixels[..., :3].astype(float), 2, 0)
        inverse = 1000 / np.maximum((r + 256 * g + 65536 * b) / (2**24 - 1) * 1000, 1e-2)
        return {"": (blocks(inverse).mean(axis=2), {"rtol": 1e-3, "atol": 1e-3})}
    colours, cells = pixels[..., :3].reshape(-1, 3), blocks(pixels[..., :3].mean(axis=2))
    return {
        "": (np.append(colours.mean(axis=0), colours.std(axis=0)), {"atol": 0.05}),
        "blocks": (np.append(cells.mean(axis=2), cells.std(axis=2)), {"atol": 2.0}),  # a pixel at an edge may flip
    }


def blocks(image):
    """(rows, columns, pixels) of an image's blocks."""
    rows, columns = image.shape[0] // BLOCK_PX, image.shape[1] // BLOCK_PX
    cells = image[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, columns, BLOCK_PX)
    return cells.swapaxes(1, 2).reshape(rows, columns, -1)
