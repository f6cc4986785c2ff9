"""A contradiction between two inputs, or between an input and a result, and its stored form."""

import json
from collections.abc import Iterable
from dataclasses import dataclass

import msgspec


@dataclass(frozen=True)
class Finding:
    """Two values that contradict each other beyond their errors.

    Args:
        code: names the kind of contradiction, such as ``camera_height``.
        text: one line for the user: both values, the likely causes, and the option that mends it.
    """

    code: str
    text: str

    def __str__(self) -> str:
        return f"{self.code}: {self.text}"


def encoded_findings(findings: Iterable[Finding]) -> str:
    """Findings as JSON, as results store them."""
    return json.dumps([vars(finding) for finding in findings])


def decoded_findings(text: str) -> tuple[Finding, ...]:
    """The findings that a result stores; none if the text is not a list of findings."""
    try:
        return msgspec.json.decode(text, type=tuple[Finding, ...])
    except (msgspec.MsgspecError, RecursionError, UnicodeError):
        return ()


@dataclass(frozen=True)
class Evidence:
    """Facts of one frame, beside its row, from which findings are made; None if unknown.

    Args:
        mounting_m: height of the surface's camera by the transforms.
        rough_ratio: share of neighbouring pixels of the depth image whose depths differ by metres.
        road_known_ratio: share of the road's pixels with a depth, from camera or stereo.
        road_depth_ratio: median of their depth / the depth of the ground there.
        pitch_deg: angle between the road by motion or lanes, without depth, and that by the mounting.
    """

    mounting_m: float | None = None
    rough_ratio: float | None = None
    road_known_ratio: float | None = None
    road_depth_ratio: float | None = None
    pitch_deg: float | None = None
