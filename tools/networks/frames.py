"""Tags and detections of one image: the networks' raw results, which depend on the image only, and their corrections.

Raw results may be computed in parallel. The corrections follow frame by frame, because the horizon is a running median.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float32
from roadperc_stream.model import Detection, Image, Mask

from . import boxes as of_boxes
from .boxes import Boxes
from .description import DetectionKeys, Network, SegmentationKeys
from .pixels import as_seen, placement, require_orientation, tensor
from .plausibility import ROAD
from .semantic import HorizonEstimate, RoadMasks, corrected, full_size_scores, seen_mask
from .session import Session, open_session, require_output

MARKING: Final = "road_line"


@dataclass(frozen=True)
class RawResult:
    """Results of the networks for one image, before the corrections.

    ``masks`` are (H, W) pixels by class; a later class hides an earlier one. None without such a network.
    """

    size: tuple[int, int]
    """Columns and rows."""
    masks: Mapping[str, Mask] | None
    boxes: Boxes | None


@dataclass(frozen=True)
class Inferred:
    """Results of one image: (H, W) tags and detections, None without such a network."""

    tags: Image | None
    detections: tuple[Detection, ...] | None


@dataclass(frozen=True)
class Pair:
    """The loaded networks, at most one for each role."""

    segmentation: tuple[Network, SegmentationKeys, Session] | None = None
    detections: tuple[Network, DetectionKeys, Session] | None = None

    @property
    def sessions(self) -> dict[str, tuple[Network, Session]]:
        """Network and session by role."""
        both = {"segmentation": self.segmentation, "detections": self.detections}
        return {role: (part[0], part[2]) for role, part in both.items() if part is not None}

    def raw(self, bgr: Image) -> RawResult:
        """Return the networks' results for an (H, W, 3) image; several threads may call it.

        Raises:
            ConfigError: an output's shape or the image's orientation does not fit the TOML file.
        """
        size = bgr.shape[1], bgr.shape[0]
        return RawResult(
            size,
            None if self.segmentation is None else class_masks(*self.segmentation, bgr),
            None if self.detections is None else object_boxes(*self.detections, bgr),
        )

    def results(
        self, raw: RawResult, horizon: HorizonEstimate, camera_height_m: float
    ) -> tuple[HorizonEstimate, Inferred]:
        """Return the horizon after this frame, and its tags and detections."""
        detections = boxes = None
        if raw.boxes is not None and self.detections is not None:
            boxes = of_boxes.possible(self.detections[1], raw.boxes, raw.size)
            detections = of_boxes.detections(self.detections[1], boxes)
        if raw.masks is None or self.segmentation is None:
            return horizon, Inferred(None, detections)
        keys = self.segmentation[1]
        rows, columns = raw.size[::-1]
        none = np.zeros((rows, columns), bool)
        masks = RoadMasks(raw.masks.get(ROAD, none), raw.masks.get(MARKING, none))
        corners = np.zeros((0, 4)) if boxes is None else boxes.corners
        horizon, masks = corrected(keys.corrections, camera_height_m, horizon, masks, corners)
        return horizon, Inferred(_tags(keys, raw.masks, masks), detections)


def load(networks: Sequence[Network]) -> Pair:
    """Load networks, at most one for each role.

    Raises:
        ConfigError: a model cannot be loaded, or does not fit its TOML file.
    """
    pair = Pair()
    for network in networks:
        keys, session = network.keys.output, open_session(network)
        if isinstance(keys, SegmentationKeys):
            pair = Pair((network, keys, session), pair.detections)
        else:
            pair = Pair(pair.segmentation, (network, keys, session))
    return pair


def class_masks(network: Network, keys: SegmentationKeys, session: Session, bgr: Image) -> dict[str, Mask]:
    """Return the (H, W) pixels of each class.

    Raises:
        ConfigError: as ``Pair.raw``.
    """
    outputs = _outputs(network, session, bgr)
    place = placement(network.keys.input, (bgr.shape[1], bgr.shape[0]))
    scores = [
        full_size_scores(place.cut(_channels(network, output), network.keys.input.size), bgr.shape[:2])
        for output in outputs
    ]
    if keys.decoder == "heads":
        return {name: _of_head(head) for name, head in zip(keys.classes.values(), scores, strict=True)}
    best = scores[0].argmax(axis=0)
    found: dict[str, Mask] = {}
    for channel, name in keys.classes.items():
        found[name] = found.get(name, np.zeros(best.shape, bool)) | (best == int(channel))
    return found


def _channels(network: Network, output: Float32) -> Float32:
    """(C, h, w) scores of an output."""
    scores = output[0] if output.ndim == 4 else np.zeros((0, 0, 0), np.float32)
    scores = scores if network.keys.input.layout == "NCHW" else scores.transpose(2, 0, 1)
    keys = network.keys.output
    if keys.decoder == "heads":
        fits, expected = len(scores) in (1, 2), "[1, 1 or 2, rows, columns]"
    else:
        least = 1 + max(map(int, keys.classes))
        fits, expected = len(scores) >= max(least, 2), f"[1, {least} or more, rows, columns]"
    require_output(network, "of scores", output.shape, expected, fits=fits)
    return scores


def _of_head(scores: Float32) -> Mask:
    """(H, W) pixels of a head's class, from (2, H, W) scores of other and class, or (1, H, W) logits."""
    return np.asarray(scores[1] > scores[0] if len(scores) == 2 else scores[0] > 0)


def object_boxes(network: Network, keys: DetectionKeys, session: Session, bgr: Image) -> Boxes:
    """Return the boxes of an image in its pixels, without duplicates.

    Raises:
        ConfigError: as ``Pair.raw``.
    """
    size = bgr.shape[1], bgr.shape[0]
    found = of_boxes.decoded(network, keys, _outputs(network, session, bgr))
    place = placement(network.keys.input, size)
    found = Boxes(place.in_image(found.corners), found.scores, found.classes)
    if keys.tiles == "centre":
        x0, y0, x1, y1 = tile = of_boxes.centre_tile(size)
        part = of_boxes.decoded(network, keys, _outputs(network, session, bgr[y0:y1, x0:x1]))
        found = found.with_others(of_boxes.of_tile(part, tile, placement(network.keys.input, (x1 - x0, y1 - y0))))
    return of_boxes.without_duplicates(keys, found)


def _outputs(network: Network, session: Session, bgr: Image) -> list[Float32]:
    require_orientation(network, (bgr.shape[1], bgr.shape[0]))
    return session.run(tensor(network.keys.input, as_seen(network.keys.input, bgr)))


def _tags(keys: SegmentationKeys, by_class: Mapping[str, Mask], road: RoadMasks) -> Image:
    """(H, W) tags in the network's table; the road and its markings are the corrected ones."""
    table, seen = keys.table, seen_mask(keys.corrections, road.drivable.shape)
    tags = np.zeros(seen.shape, np.uint8)
    for name, mask in {**by_class, ROAD: road.drivable, MARKING: road.markings}.items():
        if name in table.names:
            tags[mask & seen] = table.names.index(name)
    return tags
