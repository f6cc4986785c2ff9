"""A picture of what a network sees and finds in one image, so that a wrong size or order of colours is visible."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from roadperc_stream.errors import ConfigError
from roadperc_stream.formats.images import decode_bgr, encode_png
from roadperc_stream.model import Image
from roadperc_stream.system.files import require_free, write_whole
from roadperc_stream.system.text import print_line
from roadperc_stream.system.threads import in_order, one_thread

from .description import Network, SegmentationKeys, read_network
from .frames import Inferred, load
from .pixels import as_seen
from .plausibility import RoadCheck
from .semantic import HorizonEstimate

_HEIGHT_PX: Final = 400
_HEADING_PX: Final = 24
_HEIGHT_M: Final = 1.5
_WHITE: Final = (255, 255, 255)


def check(description: Path, image: Path, out: Path, *, force: bool) -> None:
    """Write the picture: the input and the results, first as described, then with the other order of colours.

    Raises:
        RoadpercError: the network or the image cannot be read, or the picture cannot be written.
    """
    require_free(out, force=force, suffix=".png", source=image)
    network = read_network(description)
    try:
        bgr = decode_bgr(image.read_bytes())
    except OSError as error:
        raise ConfigError(f"{image}: {error.strerror or error}") from error
    seen = ((network, "as described"), (_with_other_colours(network), "for comparison"))
    with one_thread():  # in another thread, so that Ctrl-C ends an endless network
        rows = list(in_order(lambda each: _row(*each, bgr), seen, 1))
    width = max(row.shape[1] for row in rows)
    picture = np.vstack([np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0))) for row in rows])
    write_whole(out, encode_png(picture), force=force)
    print_line(f"left: the network's input; right: its results; below: with the other order of colours: {out}")


def _with_other_colours(network: Network) -> Network:
    other = {"colours": network.keys.input.colours[::-1]}
    keys = network.keys.model_copy(update={"input": network.keys.input.model_copy(update=other)})
    return replace(network, keys=keys)


def _row(network: Network, heading: str, bgr: Image) -> Image:
    """(H, W, 3) input and results side by side, below a line of text."""
    pair, keys = load([network]), network.keys.input
    _, found = pair.results(pair.raw(bgr), HorizonEstimate(), _HEIGHT_M)
    seen = as_seen(keys, bgr)[..., ::-1]  # as if the first channel were red: BGR looks blue
    size = "x".join(map(str, keys.size))
    facts = f'colours = "{keys.colours}", {heading}; input {size}, {keys.resize}; {_facts(network, found)}'
    sides = [cv2.resize(side, (round(side.shape[1] * _HEIGHT_PX / side.shape[0]), _HEIGHT_PX))
             for side in (np.ascontiguousarray(seen), _drawn(network, bgr, found))]  # fmt: skip
    pictures = np.hstack(sides)
    head = np.zeros((_HEADING_PX, pictures.shape[1], 3), np.uint8)
    cv2.putText(head, facts, (4, _HEADING_PX - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _WHITE, 1, cv2.LINE_AA)
    print_line(facts)
    return np.vstack((head, pictures))


def _facts(network: Network, found: Inferred) -> str:
    keys = network.keys.output
    if found.tags is None or not isinstance(keys, SegmentationKeys):
        scores = [item.score for item in found.detections or ()]
        return f"{len(scores)} boxes, best score {max(scores, default=0):.2f}"
    road = RoadCheck()
    road.add(keys.table, found.tags)
    if not road.before:
        return "no class road"
    return f"{road.before[0]:.0%} of the road before the car, {road.above[0]:.0%} of the image's upper part drivable"


def _drawn(network: Network, bgr: Image, found: Inferred) -> Image:
    """(H, W, 3) image with tinted classes or boxes."""
    picture, keys = bgr.copy(), network.keys.output
    if found.tags is not None and isinstance(keys, SegmentationKeys):
        tints = np.array(keys.table.colours, np.uint8)[:, ::-1]
        tagged = found.tags > 0
        picture[tagged] = picture[tagged] // 2 + tints[found.tags[tagged]] // 2
    for item in found.detections or ():
        corners = [round(side) for side in vars(item.box_px).values()]
        cv2.rectangle(picture, tuple(corners[:2]), tuple(corners[2:]), (0, 0, 255), 2)
    return picture
