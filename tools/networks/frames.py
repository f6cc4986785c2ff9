"""Tags and detections of one image: the networks' raw results, which depend on the image only, and their corrections.

Raw results may be computed in parallel. The corrections follow frame by frame, because the horizon is a running median.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Generic, TypeVar

import numpy as np

from roadperc_stream.errors import ConfigError
from roadperc_stream.geometry import Float32
from roadperc_stream.model import Detection, Image, Mask

from . import detected_boxes as of_boxes
from .description import DetectionKeys, Network, SegmentationKeys
from .detected_boxes import Boxes
from .pixels import as_seen, placement, require_orientation, tensor
from .plausibility import ROAD
from .semantic import HorizonEstimate, RoadMasks, corrected, full_size_scores, seen_mask
from .session import Session, open_session, require_output

MARKING: Final = "road_line"
Keys = TypeVar("Keys", SegmentationKeys, DetectionKeys)


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
class Loaded(Generic[Keys]):
    """A network that can run, and the keys of its output."""

    network: Network
    keys: Keys
    session: Session

    def outputs(self, bgr: Image) -> list[Float32]:
        """Return the outputs for an (H, W, 3) image.

        Raises:
            ConfigError: the model cannot run, or the image's orientation does not fit.
        """
        require_orientation(self.network, (bgr.shape[1], bgr.shape[0]))
        keys = self.network.keys.input
        return self.session.run(tensor(keys, as_seen(keys, bgr)))


@dataclass(frozen=True)
class Pair:
    """The loaded networks, at most one for each role."""

    segmentation: Loaded[SegmentationKeys] | None = None
    detections: Loaded[DetectionKeys] | None = None

    @property
    def by_role(self) -> dict[str, Loaded[SegmentationKeys] | Loaded[DetectionKeys]]:
        """The networks by role."""
        return {loaded.network.role: loaded for loaded in (self.segmentation, self.detections) if loaded is not None}

    def raw(self, bgr: Image) -> RawResult:
        """Return the networks' results for an (H, W, 3) image; several threads may call it.

        Raises:
            ConfigError: an output's shape or the image's orientation does not fit the TOML file.
        """
        masks = None if self.segmentation is None else class_masks(self.segmentation, bgr)
        boxes = None if self.detections is None else object_boxes(self.detections, bgr)
        return RawResult((bgr.shape[1], bgr.shape[0]), masks, boxes)

    def results(
        self, raw: RawResult, horizon: HorizonEstimate, camera_height_m: float
    ) -> tuple[HorizonEstimate, Inferred]:
        """Return the horizon after this frame, and its tags and detections."""
        detections, corners = None, np.zeros((0, 4))
        if raw.boxes is not None and self.detections is not None:
            boxes = of_boxes.possible(self.detections.keys, raw.boxes, raw.size)
            detections, corners = of_boxes.detections(self.detections.keys, boxes), boxes.corners
        if raw.masks is None or self.segmentation is None:
            return horizon, Inferred(None, detections)
        keys, none = self.segmentation.keys, np.zeros(raw.size[::-1], bool)
        masks = RoadMasks(raw.masks.get(ROAD, none), raw.masks.get(MARKING, none))
        horizon, masks = corrected(keys, camera_height_m, horizon, masks, corners)
        return horizon, Inferred(_tags(keys, raw.masks, masks), detections)


def load(networks: Sequence[Network]) -> Pair:
    """Load networks.

    Raises:
        ConfigError: two compute the same channel, or a model cannot be loaded or does not fit its TOML file.
    """
    pair = Pair()
    for network in networks:
        keys, other = network.keys.output, pair.by_role.get(network.role)
        if other is not None:
            paths = f"{other.network.path} and {network.path}"
            raise ConfigError(f"{paths} both compute {network.role}; pass one of them")
        if isinstance(keys, SegmentationKeys):
            pair = replace(pair, segmentation=Loaded(network, keys, open_session(network)))
        else:
            pair = replace(pair, detections=Loaded(network, keys, open_session(network)))
    return pair


def class_masks(loaded: Loaded[SegmentationKeys], bgr: Image) -> dict[str, Mask]:
    """Return the (H, W) pixels of each class.

    Raises:
        ConfigError: as ``Pair.raw``.
    """
    keys, of_input = loaded.keys, loaded.network.keys.input
    place = placement(of_input, (bgr.shape[1], bgr.shape[0]))
    channels = [_channels(loaded, output) for output in loaded.outputs(bgr)]
    scores = [full_size_scores(place.cut(each, of_input.size), bgr.shape[:2]) for each in channels]
    if keys.decoder == "heads":
        heads = zip(keys.classes.values(), scores, strict=True)
        return {name: head[-1] > (head[0] if len(head) == 2 else 0) for name, head in heads}
    best = scores[0].argmax(axis=0)
    masks: dict[str, Mask] = {}
    for channel, name in keys.classes.items():
        masks[name] = masks.get(name, np.zeros(best.shape, bool)) | (best == int(channel))
    return masks


def _channels(loaded: Loaded[SegmentationKeys], output: Float32) -> Float32:
    """(C, h, w) scores of an output; a head has those of other and class, or the class's logits."""
    keys = loaded.keys
    scores = output[0] if output.ndim == 4 and len(output) == 1 else np.zeros((0, 0, 0), np.float32)
    scores = scores if loaded.network.keys.input.layout == "NCHW" else scores.transpose(2, 0, 1)
    if keys.decoder == "heads":
        fits, expected = len(scores) in (1, 2), "[1, 1 or 2, rows, columns]"
    else:
        least = max(2, *(1 + int(channel) for channel in keys.classes))
        fits, expected = len(scores) >= least, f"[1, {least} or more, rows, columns]"
    require_output(loaded.network, "of scores", output.shape, expected, fits=fits and scores.size > 0)
    return scores


def object_boxes(loaded: Loaded[DetectionKeys], bgr: Image) -> Boxes:
    """Return the boxes of an image in its pixels, without duplicates.

    Raises:
        ConfigError: as ``Pair.raw``.
    """

    def boxes_in(image: Image) -> Boxes:
        boxes = of_boxes.decoded(loaded.network, loaded.keys, loaded.outputs(image))
        place = placement(loaded.network.keys.input, (image.shape[1], image.shape[0]))
        return replace(boxes, corners=place.in_image(boxes.corners))

    boxes = boxes_in(bgr)
    if loaded.keys.tiles == "centre":
        x, y = bgr.shape[1] // 4, bgr.shape[0] // 4
        tile = bgr[y : y + bgr.shape[0] // 2, x : x + bgr.shape[1] // 2]
        boxes = boxes.with_others(of_boxes.of_tile(boxes_in(tile), (x, y), (tile.shape[1], tile.shape[0])))
    return of_boxes.without_duplicates(loaded.keys, boxes)


def _tags(keys: SegmentationKeys, by_class: Mapping[str, Mask], road: RoadMasks) -> Image:
    """(H, W) tags in the network's table; the road and its markings are the corrected ones."""
    table, seen = keys.table, seen_mask(keys, road.drivable.shape)
    tags = np.zeros(seen.shape, np.uint8)
    for name, mask in {**by_class, ROAD: road.drivable, MARKING: road.markings}.items():
        if name in table.names:
            tags[mask & seen] = table.names.index(name)
    return tags
