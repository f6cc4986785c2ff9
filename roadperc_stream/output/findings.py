"""Findings: where the results of a replay contradict its inputs beyond their errors."""

from collections.abc import Iterator, Mapping, Sequence
from statistics import median, mode
from typing import Final

from roadperc_stream.model.finding import Evidence, Finding
from roadperc_stream.model.reason import UNUSABLE
from roadperc_stream.output.pose_evidence import PoseEvidence
from roadperc_stream.output.reason_counts import ReasonCounts
from roadperc_stream.output.spread import Spread, spread_of
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.system.text import number

Frames = Sequence[tuple[FrameMetrics, Evidence]]
_STDS: Final = 3.0
_HEIGHT_SHARE: Final = 0.1
_LEAST_HEIGHT_STD_M: Final = 0.02
"""Standard deviation of the height that even a single frame has."""
_HEIGHTS_M: Final = (0.05, 10.0)
"""Lowest and highest camera of any vehicle, without a mounting."""
_ROUGH: Final = 0.3
"""Share of rough neighbours; depth of scenes has a tenth at most, in the wrong byte order two thirds or more."""
_WIDTHS_M: Final = (2.3, 4.8)
_USUAL_LANE_M: Final = 3.5
_FEWEST_FRAMES: Final = 3
"""Least number of frames that show a width or a pitch."""
_STEEPEST_DEG: Final = 8.0
"""Largest usual difference of pitch between mounting and road."""
_HIGH_M: Final = 3.0
"""Camera height above which a rejected wide lane counts. Else a line is missing, and that of the next lane is seen."""
_ROAD_FACTOR: Final = 10.0
"""Factor between measured and expected depth of the road that no vehicle ahead and no bonnet explains."""
_FEWEST_KNOWN: Final = 0.4
"""Share of the road's pixels with a depth; exchanged cameras match a third of them by chance."""
_SOURCES: Final = {
    "depth": "depth",
    "stereo": "stereo depth",
    "lidar": "lidar",
    "lower_image": "depth of the lower image",
}
"""Measured sources of the surface, in words."""
_OPTIONS: Final = "pass --depth-coding to roadperc-convert, or --fov, --height or --calibration"


class Contradictions:
    """Collects the evidence of the frames of a replay, in bounded memory."""

    def __init__(self) -> None:
        self._frames, self._poses = Spread[tuple[FrameMetrics, Evidence]](), PoseEvidence()

    def add(self, row: FrameMetrics, evidence: Evidence) -> None:
        """Count a frame."""
        self._frames.add((row, evidence))
        self._poses.add(row)

    @property
    def mounting_m(self) -> float | None:
        """Median height of the camera by the transforms; None without transforms."""
        known = [found.mounting_m for _, found in self._frames.values if found.mounting_m is not None]
        return median(known) if known else None

    def findings(self) -> tuple[Finding, ...]:
        """The findings of all frames."""
        frames = self._frames.values
        rough = depth_rough([found.rough_ratio for _, found in frames if found.rough_ratio is not None])
        of_road = (camera_height(frames), road_depth(frames), lane_width(frames)) if rough is None else (rough,)
        pitch = camera_pitch([found.pitch_deg for _, found in frames if found.pitch_deg is not None])
        return tuple(found for found in (*of_road, pitch, *self._poses.findings()) if found is not None)


def camera_height(frames: Frames) -> Finding | None:
    """Whether measured camera heights contradict the mounting; without one, whether no vehicle has such a camera."""
    measured = [
        (row.camera_height_m, found.mounting_m, row.surface_source)
        for row, found in frames
        if row.camera_height_m is not None and row.surface_source in _SOURCES
    ]
    if not measured:
        return None
    height_m = median(height for height, _, _ in measured)
    said = f"the camera is {_metres(height_m)} above the road by the {_SOURCES[mode(s for _, _, s in measured) or '']}"
    wrong = f"scale of the depth, baseline, field of view or mounting is wrong: {_OPTIONS}"
    mounted = [(height - mounting_m, mounting_m) for height, mounting_m, _ in measured if mounting_m is not None]
    if not mounted:
        low_m, high_m = _HEIGHTS_M
        odd = not low_m <= height_m <= high_m
        return Finding("camera_height", f"{said}, expected {low_m:g} to {high_m:g} m; {wrong}") if odd else None
    off_m, std_m = spread_of([off for off, _ in mounted])
    mounting_m = median(mounting for _, mounting in mounted)
    if abs(off_m) <= max(_STDS * max(std_m, _LEAST_HEIGHT_STD_M), _HEIGHT_SHARE * abs(mounting_m)):
        return None
    factor = f" ({_plain(height_m / mounting_m)} times)" if mounting_m > 0 else ""
    return Finding("camera_height", f"{said}, {_metres(mounting_m)} by the transforms{factor}; {wrong}")


def camera_pitch(pitches_deg: Sequence[float]) -> Finding | None:
    """Whether the pitch by lanes or motion is far from the mounting's; ``pitches_deg`` are the differences, degrees."""
    if len(pitches_deg) < _FEWEST_FRAMES or median(pitches_deg) <= _STEEPEST_DEG:
        return None
    return Finding(
        "camera_pitch",
        f"the lanes or the motion show a pitch of the camera {_plain(median(pitches_deg))} degrees from its mounting, "
        f"expected at most {_STEEPEST_DEG:g}; field of view, pitch of the mounting or lens is wrong: pass --fov or "
        "--calibration to roadperc-convert",
    )


def depth_rough(shares: Sequence[float]) -> Finding | None:
    """Whether depth is rough in most frames; ``shares`` are those of rough neighbours in each frame."""
    if not shares or median(shares) <= _ROUGH:
        return None
    return Finding(
        "depth_rough",
        f"{_percent(median(shares))} of the neighbouring pixels with different depths differ by metres, expected at "
        f"most {_percent(_ROUGH)}; byte order (red and blue exchanged, big endian) or unit is wrong, or no depth: "
        "exchange the bytes in the files, or correct the encoding of the messages",
    )


def road_depth(frames: Frames) -> Finding | None:
    """Whether most frames show no road in the depth, and its pixels have no depth or one of another scale."""
    road = [(row, found) for row, found in frames if found.road_known_ratio is not None]
    if not road or 2 * sum(row.surface_source in _SOURCES for row, _ in road) >= len(road):
        return None
    shares = [found.road_known_ratio or 0.0 for _, found in road]
    ratios = [found.road_depth_ratio for _, found in road if found.road_depth_ratio is not None]
    if median(shares) < _FEWEST_KNOWN:
        return Finding(
            "road_depth",
            f"{_percent(median(shares))} of the road's pixels have a depth, expected most of them; their disparities "
            "are not among those searched (baseline of another unit, stereo.disparities too small), left and right "
            "are exchanged, or the sensor sees nothing there: correct P of the right camera or the topics of the roles",
        )
    factor = median(ratios)
    if 1 / _ROAD_FACTOR <= factor <= _ROAD_FACTOR:
        return None
    expected = "times as far away as the ground by the height of the camera"
    text = f"the lower image is {_plain(factor)} {expected}; the unit of the depth or of the baseline is wrong"
    return Finding("road_depth", f"{text}: {_OPTIONS}")


def lane_width(frames: Frames) -> Finding | None:
    """Whether the lane is too narrow or too wide in most frames that measure its width, also if they reject it."""
    narrow, wide = _WIDTHS_M
    measured: list[tuple[FrameMetrics, float]] = []
    for row, _ in frames:
        both = row.lane_left_status == row.lane_right_status == "measured"
        rejected_m = next((float(why.values[1]) for why in row.reasons if why.code == "lane_width"), 0.0)
        if row.lane_width_m is not None and both:
            measured.append((row, row.lane_width_m))
        elif rejected_m and (rejected_m < narrow or (row.camera_height_m or 0.0) > _HIGH_M):
            measured.append((row, rejected_m))
    rows, widths_m = [row for row, _ in measured], [width for _, width in measured]
    if len(widths_m) < _FEWEST_FRAMES or 2 * sum(not narrow <= width <= wide for width in widths_m) <= len(widths_m):
        return None
    width_m, heights_m = median(widths_m), [row.camera_height_m for row in rows if row.camera_height_m is not None]
    height = ""
    if heights_m:
        usual_m, source = median(heights_m) * _USUAL_LANE_M / width_m, mode(row.surface_source for row in rows)
        height = f" with a camera height of {_metres(median(heights_m))} ({source}; {_USUAL_LANE_M} m would need "
        height += f"{_metres(usual_m)})"
    text = f"the lane is {_metres(width_m)} wide{height}, expected {narrow} to {wide} m"
    wrong = "height, field of view or pitch of the camera, or the scale of the depth is wrong"
    return Finding("lane_width", f"{text}; {wrong}: {_OPTIONS}")


def undecodable(reasons: ReasonCounts, unreadable: Mapping[str, int], reference: str, frames: int) -> Iterator[Finding]:
    """Roles whose messages cannot be used in more than half of the frames.

    ``unreadable`` counts the messages of each role that are in no frame; those of ``reference`` would have made more.
    """
    unusable = [count for count in reasons.values() if count.reason.code in UNUSABLE]
    for role in sorted({*unreadable, *(count.reason.source for count in unusable)}):
        own = [count for count in unusable if count.reason.source == role]
        bad = sum(count.frames for count in own) + unreadable.get(role, 0)
        expected = frames + (unreadable.get(role, 0) if role == reference else 0)
        if 2 * bad > expected:
            why = f" ({own[0].reason.text})" if own else ""
            text = f"{role}: its messages cannot be used in {bad} of {number(expected, 'frame')}{why}"
            hint = "roadperc-info shows their encoding, docs/recordings.md those that are read"
            yield Finding("undecodable", f"{text}; {hint}")


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _metres(value_m: float) -> str:
    return f"{_plain(value_m)} m"


def _plain(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
