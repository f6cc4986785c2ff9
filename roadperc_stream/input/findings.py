"""Findings that the input alone shows: in its cameras, transforms, labels and tags."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from math import atan, degrees
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.formats.images import value_counts
from roadperc_stream.geometry import Camera
from roadperc_stream.input.assemble import EGO_FRAMES, ego_T_camera_of, lidar_mounting
from roadperc_stream.input.calibrations import calibration_role
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.topics import CAMERA_OF
from roadperc_stream.input.transforms import LatchedState
from roadperc_stream.model import Detection, PointCloud, TagImage
from roadperc_stream.model.finding import Finding
from roadperc_stream.model.tag_tables import TagTable, classes_of_label, known_label, normal_label
from roadperc_stream.system.text import number

_FIELD_OF_VIEW_DEG: Final = (15.0, 150.0)
_MIDDLE: Final = (0.25, 0.75)
"""The part of the image's width and height that the principal point lies in."""
_LONGEST_BASELINE_M: Final = 3.0
_MASKS: Final = 20
"""Most masks of a log that are examined, at equal distances."""
_MOST_NAMED: Final = 5
_WITHOUT_CLASS: Final = ("misc", "other", "unknown", "dontcare")
"""Labels that say themselves that their things have no class."""
_MOST_LABELS: Final = 1000
"""Different labels that are counted one by one."""


def camera_findings(name: str, camera: Camera, option: str) -> Iterator[Finding]:
    """Findings on one camera: its field of view, principal point and baseline.

    ``name`` is its topic or frame, ``option`` the one that gives it another calibration.
    """
    fov_deg = degrees(2 * atan(camera.width / (2 * camera.fx)))
    low_deg, high_deg = _FIELD_OF_VIEW_DEG
    if not low_deg <= fov_deg <= high_deg:
        said = f"fx {camera.fx:g} for {number(camera.width, 'column')} is a field of view of {fov_deg:.1f} degrees"
        text = f"{name}: {said}, expected {low_deg:g} to {high_deg:g}; for the right calibration pass {option}"
        yield Finding("field_of_view", text)
    centre = camera.cx / camera.width, camera.cy / camera.height
    if not all(_MIDDLE[0] <= part <= _MIDDLE[1] for part in centre):
        said = f"principal point ({camera.cx:g}, {camera.cy:g}) of an image of {camera.width}x{camera.height}"
        where = "expected in the middle half; is it of another resolution, or a part of an image?"
        yield Finding("principal_point", f"{name}: {said}, {where} For the right calibration pass {option}")
    if camera.baseline_m is not None and abs(camera.baseline_m) > _LONGEST_BASELINE_M:
        text = f"baseline {camera.baseline_m:g} m, expected at most {_LONGEST_BASELINE_M:g}; is it in millimetres?"
        yield Finding("stereo_baseline", f"{name}: {text} Pass --calibration FILE with baseline_m")


def label_findings(topic: str, unknown: Counter[str], detections: int) -> Iterator[Finding]:
    """A finding on labels without a class; ``detections`` is the number of all boxes."""
    if unknown:
        some = [f"{label[:50]!r} ({count})" for label, count in unknown.most_common(_MOST_NAMED)]
        named = f"{', '.join(some)}{', ...' * (len(unknown) > len(some))}"
        boxes = f"{unknown.total()} of {number(detections, 'detection')}"
        fate = 'tags do not judge these boxes, they are kept; pass roadperc-replay --labels FILE, such as auto = "car"'
        yield Finding("labels", f"{topic}: unknown labels of {boxes}: {named}; {fate}")


def tag_findings(topic: str, table: TagTable, pixels: NDArray[np.int64], masks: int) -> Iterator[Finding]:
    """Findings on the values of masks; ``pixels`` is the (256,) number of pixels of each tag."""
    present = [int(tag) for tag in np.flatnonzero(pixels)]
    if strange := [tag for tag in present if tag >= len(table.names) or tag in table.gaps]:
        share = 100 * pixels[strange].sum() / pixels.sum()
        some = ", ".join(map(str, strange[:_MOST_NAMED])) + ", ..." * (len(strange) > _MOST_NAMED)
        text = f"{topic}: tags {some} are not in the table {table.title}, {share:.3g} % of the pixels"
        yield Finding("tags", f"{text}; for another table pass --set tag_table=NAME (docs/settings.md)")
    if len(present) == 1:
        text = f"every pixel of {number(masks, 'mask')} has the tag {present[0]} ({table.name_of(present[0])})"
        yield Finding("single_tag", f"{topic}: {text}; for another channel pass --topic segmentation=/TOPIC")


def transform_findings(
    latched: LatchedState, camera: Camera, lidar_frame: str | None, height_m: float
) -> Iterator[Finding]:
    """Findings on sensors that the transforms do not connect with ego; ``height_m`` is the assumed height.

    Transforms between sensors alone say nothing of the vehicle.
    """
    tree, sensors = latched.tree, {lidar_frame, *(one.frame_id for one in latched.cameras.values())}
    frames = list(dict.fromkeys(name for edge in tree.edges.values() for name in (edge.parent, edge.child)))
    if sensors.issuperset(frames):
        return
    some = ", ".join(map(repr, frames[:_MOST_NAMED])) + ", ..." * (len(frames) > _MOST_NAMED)
    ego = f"no transform leads from the vehicle ({' or '.join(EGO_FRAMES)})"
    ego_T_camera = ego_T_camera_of(tree, camera)
    if ego_T_camera is None:
        text = f"{ego} to the camera {camera.frame_id!r}, only between {some}: a height of {height_m:g} m is assumed"
        yield Finding("camera_transform", f"{text}; for the right height pass --height METRES")
    elif lidar_frame is not None and lidar_mounting(tree, ego_T_camera, camera, lidar_frame) is None:
        yield Finding("lidar_transform", f"{ego} to the lidar {lidar_frame!r}, only between {some}: it is not used")


@dataclass
class InputEvidence:
    """What the findings need of the messages until now, in bounded memory.

    ``masks_to_come`` is the number of masks in the log.
    """

    labels: Mapping[str, str]
    masks_to_come: int = 0
    unknown: Counter[str] = field(default_factory=Counter)
    detections: int = 0
    lidar_frame: str | None = None
    table: TagTable | None = None
    pixels: NDArray[np.int64] = field(default_factory=lambda: np.zeros(256, np.int64))
    masks_seen: int = 0
    masks_read: int = 0

    def add(self, items: Iterable[Stamped]) -> None:
        """Examine messages."""
        for item in items:
            self._add(item)

    def _add(self, item: Stamped) -> None:
        match item.role, item.payload:
            case "detections", tuple() as detections:
                self.add_labels(d.label for d in detections if isinstance(d, Detection))
            case "lidar", PointCloud() as cloud:
                self.lidar_frame = cloud.frame_id
            case "segmentation", TagImage() as image:
                self.masks_seen += 1
                if (self.masks_seen - 1) % max(-(-self.masks_to_come // _MASKS), 1) == 0:
                    self._add_tags(image)

    def add_labels(self, labels: Iterable[str]) -> None:
        """Count the labels of detections."""
        for label in labels:
            self.detections += 1
            known = known_label(label, self.labels)
            if classes_of_label(known) is None and normal_label(known) not in _WITHOUT_CLASS:
                is_room = label in self.unknown or len(self.unknown) < _MOST_LABELS
                self.unknown[label if is_room else "others"] += 1

    def _add_tags(self, image: TagImage) -> None:
        with suppress(DecodeError):  # the replay reports it
            self.pixels += value_counts(image.tags)
            self.table, self.masks_read = image.table, self.masks_read + 1

    def findings(
        self, cfg: ReplayConfig, topics: Mapping[str, str], reference: str, latched: LatchedState
    ) -> tuple[Finding, ...]:
        """All findings; ``latched`` are the cameras and transforms at the end."""
        front = calibration_role(reference, latched.cameras)
        named = {role: topics[of] for role, of in CAMERA_OF.items() if of in topics} | {front: topics[reference]}
        found: list[Finding] = []
        for role, camera in latched.cameras.items():
            option = f"{'--fov DEGREES or ' * (role == front)}--calibration FILE"
            found += camera_findings(named[role], camera, option) if role in named else ()
        if front in latched.cameras:
            height_m = cfg.surface.assumed_height_m
            found += transform_findings(latched, latched.cameras[front], self.lidar_frame, height_m)
        found += label_findings(topics.get("detections", ""), self.unknown, self.detections)
        if self.table is not None:
            found += tag_findings(topics["segmentation"], self.table, self.pixels, self.masks_read)
        return tuple(found)
