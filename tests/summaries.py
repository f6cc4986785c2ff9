"""Small summaries of large things, for tests that compare them with a recording: documents, pictures, clouds."""

from collections import defaultdict

import cv2
import numpy as np

EXACT = {"rtol": 0.0, "atol": 0.0}
BLOCK_PX = 8
MOST_BLOCKS = 40
"""Of a picture, from left to right."""


def of_document(document):
    """What a tree of dicts and lists holds, key by key: count, mean, deviation and limits of numbers, and all texts.

    Elements of a list are taken together, and so are those of a dict whose keys are numbers, such as frames.
    """
    numbers, texts = _leaves(document)
    moments = [[len(found), np.mean(found), np.std(found), min(found), max(found)] for found in numbers.values()]
    words = np.array([f"{path}: {' '.join(sorted(found))}" for path, found in texts.items()], dtype=str)
    return {"keys": (np.array(list(numbers), dtype=str), EXACT), "": (np.array(moments), {"rtol": 1e-3, "atol": 1e-3}),
            "texts": (words, EXACT)}  # fmt: skip


def of_picture(pixels):
    """Colours of an (H, W, C) picture, and of its blocks, where a pixel at an edge may differ between machines."""
    side_px = max(pixels.shape[1] // MOST_BLOCKS, BLOCK_PX)
    colours, cells = pixels.reshape(-1, pixels.shape[2]), blocks(pixels.mean(axis=2), side_px)
    return {
        "": (np.append(colours.mean(axis=0), colours.std(axis=0)), {"atol": 0.05}),
        "blocks": (np.append(cells.mean(axis=2), cells.std(axis=2)), {"atol": 2.0}),
    }


def of_tags(tags):
    """Pixels of each tag, block by block."""
    return {"": (np.array([blocks(tags == tag).sum(axis=2) for tag in np.unique(tags)]), {"atol": 2.5})}


def of_depth(depth_m):
    """Mean inverse of the depth, block by block."""
    return {"": (blocks(1 / np.maximum(depth_m, 1e-5)).mean(axis=2), {"rtol": 1e-3, "atol": 1e-3})}


def of_points(points_m):
    """Number, middle and extent of points."""
    return {"": (np.array([len(points_m), *points_m.mean(axis=0), *points_m.std(axis=0)]), {"atol": 1e-3})}


def blocks(image, side_px=BLOCK_PX):
    """(rows, columns, pixels) of an image's blocks."""
    rows, columns = image.shape[0] // side_px, image.shape[1] // side_px
    cells = image[: rows * side_px, : columns * side_px].reshape(rows, side_px, columns, side_px)
    return cells.swapaxes(1, 2).reshape(rows, columns, -1)


def decoded_picture(data):
    """The pixels of an encoded picture as (H, W, C)."""
    return np.atleast_3d(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))


def check(regression, summaries):
    """Compare summaries, by the name of what they are of, with those recorded."""
    parts = {f"{name} {part}".strip(): value for name, found in summaries.items() for part, value in found.items()}
    values = {key: value for key, (value, _) in parts.items()}
    regression.check(values, tolerances={key: tolerance for key, (_, tolerance) in parts.items()})


def _leaves(node, path="", found=None):
    numbers, texts = found = found or (defaultdict(list), defaultdict(list))
    if isinstance(node, dict):
        for key, value in node.items():
            _leaves(value, f"{path}.{'*' if str(key).isdigit() else key}", found)
    elif isinstance(node, list | tuple):
        for value in node:
            _leaves(value, f"{path}[]", found)
    elif isinstance(node, bytes):
        numbers[path].append(len(node))
    elif isinstance(node, str) or node is None:
        texts[path].append(str(node))
    else:
        numbers[path].append(float(node))
    return numbers, texts
