"""Tags and detections of one image: the networks' raw results, which depend on the image only, and their corrections.

Raw results may be computed in parallel. The corrections follow frame by frame, because the horizon is a running median.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from roadperc_stream.errors import ConfigError
from roadperc_stream.geometry import Float32
from roadperc_stream.model import Detection, Image, Mask

from . import boxes as of_boxes
from .boxes import Boxes
from .description import DetectionKeys, Network, SegmentationKeys
from .pixels import as_seen, placement, require_orientation, tensor
from .plausibility import ROAD
from .semantic import HorizonEstimate, RoadMasks, corrected, full_size_scores, seen_mask
from .session import Session, limited_memory, open_session, require_output

MARKING: Final = "road_line"
_MOST_NUMBERS: Final = 1 << 28
"""In one output: more than 100 classes at 1920x1080 pixels."""
_MOST_CHANNELS: Final = 256
"""Each takes an image of scores."""


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
        return {part[0].role: (part[0], part[2]) for part in (self.segmentation, self.detections) if part is not None}

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

    def varying(self, bgr: Image) -> list[str]:
        """Run each network twice on an (H, W, 3) image, and return a warning for each whose outputs differ.

        No other thread may run, because the memory is limited meanwhile.

        Raises:
            ConfigError: as ``raw``.
        """
        warnings = []
        for network, session in self.sessions.values():
            with limited_memory():
                pairs = zip(*(_outputs(network, session, bgr) for _ in range(2)), strict=True)
                same = [np.array_equal(one, other, equal_nan=True) for one, other in pairs]
            if differing := [name for name, is_same in zip(session.outputs, same, strict=True) if not is_same]:
                warnings.append(
                    f"{network.keys.file}: output {', '.join(differing)} differs between two runs on the first image: "
                    "the model uses random numbers; export it for inference, or every run writes another log"
                )
        return warnings

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
        keys, none = self.segmentation[1], np.zeros(raw.size[::-1], bool)
        masks = RoadMasks(raw.masks.get(ROAD, none), raw.masks.get(MARKING, none))
        corners = np.zeros((0, 4)) if boxes is None else boxes.corners
        horizon, masks = corrected(keys, camera_height_m, horizon, masks, corners)
        return horizon, Inferred(_tags(keys, raw.masks, masks), detections)


def load(networks: Sequence[Network]) -> Pair:
    """Load networks.

    Raises:
        ConfigError: two compute the same channel, or a model cannot be loaded or does not fit its TOML file.
    """
    pair = Pair()
    for network in networks:
        keys, loaded = network.keys.output, pair.sessions
        if network.role in loaded:
            other = loaded[network.role][0].path
            raise ConfigError(f"{other} and {network.path} both compute {network.role}; pass one of them")
        if isinstance(keys, SegmentationKeys):
            pair = replace(pair, segmentation=(network, keys, open_session(network)))
        else:
            pair = replace(pair, detections=(network, keys, open_session(network)))
    return pair


def class_masks(network: Network, keys: SegmentationKeys, session: Session, bgr: Image) -> dict[str, Mask]:
    """Return the (H, W) pixels of each class.

    Raises:
        ConfigError: as ``Pair.raw``.
    """
    place, size = placement(network.keys.input, (bgr.shape[1], bgr.shape[0])), network.keys.input.size
    channels = [_channels(network, keys, output) for output in _outputs(network, session, bgr)]
    scores = [full_size_scores(place.cut(each, size), bgr.shape[:2]) for each in channels]
    if keys.decoder == "heads":
        heads = zip(keys.classes.values(), scores, strict=True)
        return {name: head[-1] > (head[0] if len(head) == 2 else 0) for name, head in heads}
    best = scores[0].argmax(axis=0)
    found: dict[str, Mask] = {}
    for channel, name in keys.classes.items():
        found[name] = found.get(name, np.zeros(best.shape, bool)) | (best == int(channel))
    return found


def _channels(network: Network, keys: SegmentationKeys, output: Float32) -> Float32:
    """(C, h, w) scores of an output; a head has those of other and class, or the class's logits."""
    scores = output[0] if output.ndim == 4 and len(output) == 1 else np.zeros((0, 0, 0), np.float32)
    scores = scores if network.keys.input.layout == "NCHW" else scores.transpose(2, 0, 1)
    if keys.decoder == "heads":
        fits, expected = len(scores) in (1, 2), "[1, 1 or 2, rows, columns]"
    else:
        least = max(2, *(1 + int(channel) for channel in keys.classes))
        most = "" if len(scores) <= _MOST_CHANNELS else f" up to {_MOST_CHANNELS}"
        fits, expected = len(scores) >= least and not most, f"[1, {least} or more{most}, rows, columns]"
    require_output(network, "of scores", output.shape, expected, fits=fits and scores.size > 0)
    return scores


def object_boxes(network: Network, keys: DetectionKeys, session: Session, bgr: Image) -> Boxes:
    """Return the boxes of an image in its pixels, without duplicates.

    Raises:
        ConfigError: as ``Pair.raw``.
    """

    def boxes_in(part: Image) -> Boxes:
        found = of_boxes.decoded(network, keys, _outputs(network, session, part))
        place = placement(network.keys.input, (part.shape[1], part.shape[0]))
        return replace(found, corners=place.in_image(found.corners))

    found = boxes_in(bgr)
    if keys.tiles == "centre":
        x, y = bgr.shape[1] // 4, bgr.shape[0] // 4
        tile = bgr[y : y + bgr.shape[0] // 2, x : x + bgr.shape[1] // 2]
        found = found.with_others(of_boxes.of_tile(boxes_in(tile), (x, y), (tile.shape[1], tile.shape[0])))
    return of_boxes.without_duplicates(keys, found)


def _outputs(network: Network, session: Session, bgr: Image) -> list[Float32]:
    require_orientation(network, (bgr.shape[1], bgr.shape[0]))
    found = session.run(tensor(network.keys.input, as_seen(network.keys.input, bgr)))
    for name, output in zip(session.outputs, found, strict=True):
        require_output(
            network, name, output.shape, f"{_MOST_NUMBERS} numbers at most", fits=output.size <= _MOST_NUMBERS
        )
    return found


def _tags(keys: SegmentationKeys, by_class: Mapping[str, Mask], road: RoadMasks) -> Image:
    """(H, W) tags in the network's table; the road and its markings are the corrected ones."""
    table, seen = keys.table, seen_mask(keys, road.drivable.shape)
    tags = np.zeros(seen.shape, np.uint8)
    for name, mask in {**by_class, ROAD: road.drivable, MARKING: road.markings}.items():
        if name in table.names:
            tags[mask & seen] = table.names.index(name)
    return tags
