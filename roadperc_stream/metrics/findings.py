"""Findings: where the results of a replay contradict its inputs beyond their errors.

``Contradictions`` keeps a few numbers of each frame, in bounded memory; pure functions turn them into findings.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from statistics import median
from typing import Final

from roadperc_stream.config import ReplayConfig
from roadperc_stream.metrics.evidence import evidence_of
from roadperc_stream.metrics.pose_evidence import PoseEvidence
from roadperc_stream.metrics.spread import Spread, spread_of
from roadperc_stream.model import FrameResult, Sample
from roadperc_stream.model.finding import Evidence, Finding
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.system.text import number

_STDS: Final = 3.0
_HEIGHT_SHARE: Final = 0.1
_LEAST_HEIGHT_STD_M: Final = 0.02
"""Standard deviation of the height that even a single frame has."""
_HEIGHTS_M: Final = (0.05, 10.0)
"""Lowest and highest camera of any vehicle, without a mounting."""
_ROUGH: Final = 0.5
_WIDTHS_M: Final = (2.3, 4.8)
_USUAL_LANE_M: Final = 3.5
_FEWEST_WIDTHS: Final = 3
_ROAD_FACTOR: Final = 10.0
"""Factor between measured and expected depth of the road that no vehicle ahead and no bonnet explains."""
_FEWEST_KNOWN: Final = 0.02
_FEWEST_SEARCHED: Final = 0.1
_MEASURED: Final = ("depth", "stereo", "lidar", "lower_image")


class Contradictions:
    """Counts the evidence of the frames of a replay."""

    def __init__(self, cfg: ReplayConfig) -> None:
        self._cfg = cfg
        self._frames = 0
        self._heights = Spread[tuple[float, float | None]]()
        self._rough = Spread[float]()
        self._widths = Spread[tuple[float, float | None, str]]()
        self._road = Spread[tuple[float, float | None, bool]]()
        self._searched = Spread[tuple[float, float]]()
        self._unusable: dict[str, tuple[str, int]] = {}
        self._poses = PoseEvidence()

    def evidence(self, sample: Sample, result: FrameResult) -> Evidence:
        """The evidence of one frame, beside its row."""
        return evidence_of(self._cfg, sample.frame, result)

    def add(self, row: FrameMetrics, evidence: Evidence) -> None:
        """Count a frame."""
        self._frames += 1
        height_m, source = row.camera_height_m, row.surface_source or ""
        if height_m is not None and source in _MEASURED:
            self._heights.add((height_m, evidence.mounting_m))
        if evidence.rough_ratio is not None:
            self._rough.add(evidence.rough_ratio)
        if row.lane_width_m is not None and row.lane_left_status == row.lane_right_status == "measured":
            self._widths.add((row.lane_width_m, height_m, source))
        if evidence.road_known_ratio is not None:
            self._road.add((evidence.road_known_ratio, evidence.road_depth_ratio, source in _MEASURED))
        if evidence.searched_ratio is not None and evidence.baseline_m is not None:
            self._searched.add((evidence.searched_ratio, evidence.baseline_m))
        for text in evidence.unusable:
            first, count = self._unusable.get(text.partition(":")[0], (text, 0))
            self._unusable[text.partition(":")[0]] = first, count + 1
        self._poses.add(row)

    def findings(self, unreadable: Mapping[str, int]) -> tuple[Finding, ...]:
        """The findings of all frames; ``unreadable`` counts the messages of each role that are not in any frame."""
        found = (
            depth_rough(self._rough.values),
            camera_height(self._heights.values),
            road_depth(self._road.values),
            stereo_range(self._searched.values),
            lane_width(self._widths.values),
            *self._poses.findings(),
            *undecodable(self._unusable, unreadable, self._frames),
        )
        return tuple(finding for finding in found if finding is not None)


def camera_height(heights_m: Sequence[tuple[float, float | None]]) -> Finding | None:
    """Whether measured camera heights contradict the mounting, which is None without a transform."""
    if not heights_m:
        return None
    measured_m = median(height_m for height_m, _ in heights_m)
    mounted = [(height_m - mounting_m, mounting_m) for height_m, mounting_m in heights_m if mounting_m is not None]
    causes = (
        "depth scale, field of view or height is wrong: pass --depth-coding or --fov to roadperc-convert, "
        "or correct the calibration or the mounting"
    )
    if not mounted:
        if _HEIGHTS_M[0] <= measured_m <= _HEIGHTS_M[1]:
            return None
        text = f"the depth puts the camera {_metres(measured_m)} above the road, expected 0.05 to 10 m"
        return Finding("camera_height", f"{text}; {causes}")
    off_m, std_m = spread_of([off for off, _ in mounted])
    mounting_m = median(mounting for _, mounting in mounted)
    if abs(off_m) <= max(_STDS * max(std_m, _LEAST_HEIGHT_STD_M), _HEIGHT_SHARE * abs(mounting_m)):
        return None
    text = f"the depth puts the camera {_metres(measured_m)} above the road, the transforms {_metres(mounting_m)}"
    return Finding("camera_height", f"{text}; {causes}")


def depth_rough(shares: Sequence[float]) -> Finding | None:
    """Whether the depth is rough in most frames; ``shares`` are those of rough pairs of neighbours."""
    if not shares or median(shares) <= _ROUGH:
        return None
    return Finding(
        "depth_rough",
        f"neighbouring pixels of the depth differ by metres in {median(shares):.0%} of the image, expected below "
        f"{_ROUGH:.0%}; the byte order is wrong (red and blue exchanged, big endian) or this is not depth: "
        "write the files again, or correct the encoding",
    )


def road_depth(road: Sequence[tuple[float, float | None, bool]]) -> Finding | None:
    """Whether the depth of the road's pixels is of another scale, or unknown, in most frames.

    ``road`` has for each frame the share of the road's pixels with a depth, its ratio to the ground's depth, and
    whether a road was found in it.
    """
    if not road or 2 * sum(found for _, _, found in road) >= len(road):
        return None
    ratios = [ratio for known, ratio, _ in road if ratio is not None and known >= _FEWEST_KNOWN]
    if 2 * len(ratios) <= len(road):
        known = median(share for share, _, _ in road)
        return Finding(
            "road_depth",
            f"{known:.1%} of the lower image has a depth, expected most of it; the left and the right camera are "
            "exchanged, the searched disparities do not fit, or the sensor sees nothing there: compare --topic left "
            "and right, the baseline and stereo.disparities",
        )
    factor = median(ratios)
    if 1 / _ROAD_FACTOR <= factor <= _ROAD_FACTOR:
        return None
    return Finding(
        "road_depth",
        f"the depth of the lower image is {factor:.2g} times that of the road in front of the mounted camera; the unit "
        "of the depth or of the baseline is wrong: pass --depth-coding to roadperc-convert, or correct P of the right "
        "camera",
    )


def stereo_range(searched: Sequence[tuple[float, float]]) -> Finding | None:
    """Whether stereo searches too few disparities for the road; ``searched`` has share and baseline of each frame."""
    if not searched or median(share for share, _ in searched) >= _FEWEST_SEARCHED:
        return None
    share, baseline_m = (median(values) for values in zip(*searched, strict=True))
    return Finding(
        "stereo_range",
        f"{share:.0%} of the road's pixels have a disparity within those searched, with a baseline of "
        f"{_metres(baseline_m)}; the baseline is in another unit, or stereo.disparities is too small: correct P of the "
        "right camera, or set stereo.disparities=auto",
    )


def lane_width(widths_m: Sequence[tuple[float, float | None, str]]) -> Finding | None:
    """Whether the lane is too narrow or too wide in most frames that measure both boundaries.

    ``widths_m`` has for each frame the width, the camera height, and its source.
    """
    narrow, wide = _WIDTHS_M
    odd = sum(not narrow <= width_m <= wide for width_m, _, _ in widths_m)
    if len(widths_m) < _FEWEST_WIDTHS or 2 * odd <= len(widths_m):
        return None
    width_m = median(width for width, _, _ in widths_m)
    heights_m = [height for _, height, _ in widths_m if height is not None]
    ((source, _),) = Counter(source for _, _, source in widths_m).most_common(1)
    height = f" with a camera height of {_metres(median(heights_m))} ({source})" if heights_m else ""
    usual = f", a lane of {_USUAL_LANE_M} m would need {_metres(median(heights_m) * _USUAL_LANE_M / width_m)}"
    return Finding(
        "lane_width",
        f"the lane is {_metres(width_m)} wide{height}, expected {narrow} to {wide} m{usual if heights_m else ''}; "
        "height, field of view or pitch of the camera, or the depth scale is wrong: pass --height or --fov, or correct "
        "the calibration",
    )


def undecodable(
    unusable: Mapping[str, tuple[str, int]], unreadable: Mapping[str, int], frames: int
) -> Iterator[Finding]:
    """Roles whose messages cannot be used in more than half of the frames; ``unusable`` has a text and a count."""
    for role in sorted({*unusable, *unreadable}):
        text, count = unusable.get(role, ("", 0))
        count += unreadable.get(role, 0)
        if 2 * count > frames:
            why = f", such as {text}" if text else ""
            yield Finding(
                "undecodable",
                f"{role}: {number(count, 'message')} cannot be used in {number(frames, 'frame')}{why}; roadperc-info "
                "shows the encoding, docs/recordings.md those that are read",
            )


def _metres(value_m: float) -> str:
    return f"{value_m:.3g} m"
