"""A recording of any kind, as ``roadperc-convert`` prints and writes it, and the messages that all kinds have."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera
from roadperc_stream.geometry.rectification import is_rectified, lens_of, rectified, resampled
from roadperc_stream.input.findings import InputEvidence, camera_findings, label_findings
from roadperc_stream.log import Channel, Message
from roadperc_stream.model import Detection
from roadperc_stream.model.tag_tables import TagTable
from roadperc_stream.output import encoding
from roadperc_stream.output.input_log import channel_of
from roadperc_stream.schemas.roles import ROLES

from .rig import Rig

P = TypeVar("P", np.uint8, np.uint16, np.float32)
COLUMNS: Final = ("role", "from", "frames", "missing", "size", "encoding")
SensorRow = tuple[str, str, str, str, str, str]
"""The printed row of a sensor, by ``COLUMNS``; empty cells are unknown."""
Messages = Callable[[list[str]], Iterator[tuple[str, Message]]]
"""Makes the messages with their roles, in log order; appends warnings about lost frames to its argument."""
JPEG_QUALITY: Final = 95
"""99 % of the pixels of a road video keep their grey value to 2 levels; at 90 to 3, in two thirds of the bytes."""
WORKERS: Final = 2


@dataclass(frozen=True)
class Recording:
    """Facts to print before the log is written, and its content."""

    title: str
    sensors: tuple[SensorRow, ...]
    facts: tuple[tuple[str, str], ...]
    frames: int
    """Number of frames for the progress bar; the header of a video may state a wrong one."""
    channels: Mapping[str, Channel]
    """Channel by role."""
    messages: Messages
    required: tuple[str, ...]
    """Roles that must get messages."""
    metadata: Mapping[str, str]
    """How the log was made, without data of the machine or the user."""
    images: Mapping[str, str] = field(default_factory=dict)
    """Stamp in nanoseconds of each labelled image by its name in the dataset's label files."""
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def channels_of(rigs: Iterable[Rig], roles: Iterable[str], tag_table: TagTable | None = None) -> dict[str, Channel]:
    """Return the channels of roles and of what the rigs state, in the order of ``ROLES``."""
    filled = {role for rig in rigs for role, _ in static_messages(rig, 0)} | set(roles)
    return {role: channel_of(role, tag_table) for role in ROLES if role in filled}


def static_messages(rig: Rig, first_ns: int) -> list[tuple[str, bytes]]:
    """Return calibrations of the rectified images, and transforms, with their roles."""
    cameras = {role: rectified(rig.cameras[role]) for role in ROLES if role in rig.cameras}
    found = [(role, encoding.encode_calibration(first_ns, camera)) for role, camera in cameras.items()]
    if rig.transforms:
        found.append(("tf", encoding.encode_transforms(first_ns, rig.transforms)))
    return found


def straightened(camera: Camera, pixels: NDArray[P], *, nearest: bool = False) -> NDArray[P]:
    """Return pixels without the distortion of their camera's lens; ``nearest`` as in ``resampled``."""
    return pixels if is_rectified(camera) else resampled(camera, rectified(camera), pixels, nearest=nearest)


def rig_facts(rig: Rig, pixel_origin: str = "") -> list[tuple[str, str]]:
    """Return name and text of each calibration, of the pixel origin if it is known, and of the mountings."""
    facts = [(role.replace("_", " "), _camera(camera)) for role, camera in rig.cameras.items()]
    facts += [("pixel origin", pixel_origin)] if pixel_origin else []
    edges = [
        f"{edge.parent} -> {edge.child} at {', '.join(f'{value:g}' for value in edge.parent_T_child[:3, 3].round(4))} m"
        for edge in rig.transforms
    ]
    return [*facts, ("mounting", "; ".join(edges) or "unknown")]


def finding_notes(rig: Rig, detections: Iterable[Detection] = ()) -> Iterator[str]:
    """Yield the findings on the cameras, and on the labels of the detections."""
    for role, camera in rig.cameras.items():
        option = f"{'--fov DEGREES or ' * (role == 'calibration')}--calibration FILE"
        yield from (str(finding) for finding in camera_findings(camera.frame_id, camera, option))
    evidence = InputEvidence({})
    evidence.add_labels(detection.label for detection in detections)
    yield from (str(found) for found in label_findings("detections", evidence.unknown, evidence.detections))


def _camera(camera: Camera) -> str:
    pair = f", baseline {camera.baseline_m:g} m" if camera.baseline_m else ""
    where = f"cx {camera.cx:g} cy {camera.cy:g} (pixel centres from 0)"
    lens = "" if is_rectified(camera) else f"; rectified from {lens_of(camera).model}"
    return f"{camera.frame_id}: fx {camera.fx:g} fy {camera.fy:g} {where}{pair}{lens}"
