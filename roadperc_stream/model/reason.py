"""Why an output is missing, unusable or replaced: a source, a code and values.

``TEMPLATES`` gives the sentence of each code. Logs and tables hold the fields of ``StoredReason``, never a sentence.
Reasons that differ only in their numbers have the same kind.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import starmap
from string import Formatter
from typing import Final, TypedDict

Value = str | int | float
TEMPLATES: Final[dict[str, str]] = {
    "switched_off": "switched off",
    "not_run": "not run",
    "no_result": "no result: {detail}",
    "not_in_log": "not in the log",
    "not_written": "not written, the frame's stamp exceeds {last_ns:d} ns (2038-01-19), the largest stamp of "
    "ROS 2 messages",
    "no_message": "no message at this frame",
    "undecodable": "cannot be decoded: {detail}",
    "wrong_size": "{width:d}x{height:d} pixels, its calibration says {expected_width:d}x{expected_height:d}",
    "no_transform": "no transform connects its frame {frame_id!r} with ego",
    "no_points_in_view": "none of its {points:d} points is in the camera's view",
    "no_finite_points_in_view": "none of its {points:d} points is in the camera's view; {infinite:d} of them are "
    "not finite",
    "time_went_back": "went back from {last_ns:d} to {stamp_ns:d} ns, state of all stages cleared",
    "time_jumped": "jumped ahead from {last_ns:d} to {stamp_ns:d} ns, state of all stages cleared",
    "lost_to_damage": "messages between {first_ns:d} and {last_ns:d} ns were lost to damage",
    "lost_to_damage_before": "messages up to {last_ns:d} ns were lost to damage",
    "lost_to_damage_after": "messages from {first_ns:d} ns on were lost to damage",
    "lost_to_damage_somewhere": "messages were lost to damage at an unknown time",
    "not_rectified": "its camera has distortion that cannot be undone; it is used as it is",
    "pixels_not_square": "fx {fx:g} and fy {fy:g} of its calibration differ by more than 5 %: cameras usually have "
    "square pixels; if one of the two is wrong, heights and pitch are wrong",
    "no_image": "no image",
    "image_unusable": "its image cannot be used",
    "image_frozen": "its image repeats while the car's pose or other sensors change",
    "image_uniform": "its image is black, white or nearly uniform",
    "no_segmentation": "no segmentation",
    "no_segmentation_lower_image": "no segmentation, the lower image is used as the road",
    "no_segmentation_not_filtered": "no segmentation, detections are not filtered",
    "no_segmentation_sparse_depth": "no segmentation, and lidar points are too sparse to classify pixels",
    "no_depth": "no depth",
    "no_depth_no_segmentation": "neither depth nor segmentation",
    "no_depth_no_distances": "no depth, no distances",
    "no_depth_ground_distances": "no depth, the boxes' lower edges on the road give the distances",
    "no_depth_plane_assumed": "no depth, {plane_source} gives the plane",
    "no_depth_pitch_estimated": "no depth, {plane_source} gives the plane, {pitch_source} gives its pitch",
    "no_detections": "no detections",
    "no_left_image": "no left image",
    "no_right_image": "no right image",
    "no_left_no_right_image": "no left image, no right image",
    "no_right_calibration": "no calibration of the right camera",
    "no_surface": "no surface: {cause}",
    "no_drivable_surface": "no drivable surface: {cause}",
    "plane_held": "the plane of earlier frames, moved by odometry, is used: {cause}",
    "heights_unknown": "the depth does not show the road, so heights above it are unknown",
    "depth_misses_road": "no segmentation, and the depth does not show the road",
    "plane_assumed": "{plane_source} gives the plane: {cause}",
    "plane_estimated": "{plane_source} gives the plane, {pitch_source} gives its pitch: {cause}",
    "too_few_road_points": "{points:d} road pixels with known depth within max_depth_m, a plane needs three",
    "no_plane": "no plane through {points:d} road points fits {share:.0%} of them",
    "plane_without_points": "no plane fits three road points",
    "plane_tilted": "the points' plane is tilted by {tilt_deg:.0f} degrees, expected at most {limit_deg:g}",
    "lost": "lost, {cause}",
    "camera_changed": "the camera differs from that of earlier frames",
    "too_few_inliers": "too few points agree on a motion",
    "impossible_motion": "the points agree on a motion that the car cannot make",
    "impossible_acceleration": "the points agree on a speed of {speed_mps:g} m/s; a car that brakes or accelerates "
    "from its last known speed has {least_mps:g} to {most_mps:g} m/s",
    "matched_by_orb": "optical flow tracked too few points, ORB features match them",
    "matched_by_orb_and": "optical flow tracked too few points, ORB features match them; {cause}",
    "scale_by_points": "the road's image shows no length that fits the speed and the points of earlier frames, these "
    "points give the scale",
    "scale_carried": "the road's image shows no length, the last known speed gives the scale",
    "scale_unknown": "neither the road's image nor the last known speed gives the scale",
    "no_baseline": "P[0][3] of the right camera is 0: expected -fx * baseline, which is {shortest_m:g} to "
    "{longest_m:g} m",
    "wrong_baseline": "P[0][3] of the right camera gives a baseline of {baseline_m:g} m: expected -fx * baseline, "
    "which is {shortest_m:g} to {longest_m:g} m",
    "camera_below_road": "the mounting puts the left camera below the road: set stereo.disparities",
    "pair_of_two_sizes": "the left camera has {left_width:d}x{left_height:d} pixels, the right one "
    "{right_width:d}x{right_height:d}",
    "pair_of_wrong_size": "{side} image: {width:d}x{height:d} pixels, its calibration says "
    "{expected_width:d}x{expected_height:d}",
    "boundary_lost": "{side} boundary not seen, {cause}",
    "no_line_near": "no line near the car on that side",
    "edges_disagree": "too few edges agree on its position",
    "car_on_boundary": "{side} boundary lost, the car is on it",
    "boundary_uncertain": "{side} boundary lost, its standard deviation {ahead_m:g} m ahead is {std_m:g} m, "
    "expected at most {limit_m:g} m",
    "lane_width": "{side} boundary lost, the lane would be {width_m:g} m wide, expected {narrowest_m:g} to "
    "{widest_m:g} m",
    "boundary_unconfirmed": "{side} boundary lost, its standard deviation {ahead_m:g} m ahead is {std_m:g} m, and "
    "the other boundary does not run beside it",
    "boundaries_cross": "{side} boundary lost, it crosses the other one {ahead_m:g} m ahead",
    "lens_without_rotation": "not rectified: the {side} camera has distortion but no R",
    "lens_without_camera_matrix": "not rectified: the {side} camera has an invalid K: {detail}",
    "lens_rotation_invalid": "not rectified: the {side} camera has an R that is not a rotation: {detail}",
    "lens_model_unknown": "not rectified: the {side} camera has distortion of model {model!r}; known: {known}",
    "lens_coefficient_count": "not rectified: the {side} camera has {count:d} distortion coefficients, expected one "
    "of {known}",
    "lens_coefficient_size": "not rectified: the {side} camera has a distortion coefficient {value:g}, expected at "
    "most {limit:g} in size",
    "other": "{text}",
}
"""The sentence of each code, without ``source: ``. ``{cause}`` is the sentence of another reason."""
MISSING_ROLES: Final[dict[str, tuple[str, ...]]] = {
    "no_image": ("image",),
    "no_segmentation": ("segmentation",),
    "no_segmentation_lower_image": ("segmentation",),
    "no_segmentation_not_filtered": ("segmentation",),
    "no_segmentation_sparse_depth": ("segmentation",),
    "no_depth": ("depth",),
    "no_depth_no_segmentation": ("depth", "segmentation"),
    "no_depth_no_distances": ("depth",),
    "no_depth_ground_distances": ("depth",),
    "no_depth_plane_assumed": ("depth",),
    "no_depth_pitch_estimated": ("depth",),
    "no_detections": ("detections",),
    "no_left_image": ("left",),
    "no_right_image": ("right",),
    "no_left_no_right_image": ("left", "right"),
}
"""The missing inputs of each code."""
_CAUSE: Final = "cause"
_CAUSE_SOURCE: Final[dict[str, str]] = {"no_surface": "surface", "no_drivable_surface": "drivable"}
"""The source of the cause, by code; for other codes it is the source of the reason itself."""
_DETAIL: Final = "detail"
"""The field with the text of a library or a file; reasons of one kind may differ in it."""
_BETWEEN_CAUSES: Final = "/"
_MOST_CAUSES: Final = 64

ReasonKind = tuple[tuple[str, ...], ...]
"""Source, code and text values of a reason, followed by those of its cause."""


class StoredReason(TypedDict):
    """A reason in tables and messages.

    ``cause`` is the code of the cause and of the cause's cause, outermost first, separated by ``/``. ``values`` are
    those of the reason, then those of its causes, as text.
    """

    source: str
    code: str
    values: list[str]
    cause: str


@dataclass(frozen=True)
class Reason:
    """Why the output of a stage, or the input of a role, is missing or replaced.

    Args:
        source: the stage or role.
        code: a key of ``TEMPLATES``.
        values: the values of the template's fields, in order, without ``cause``.
        cause: the reason that causes this one, if the template has ``{cause}``.

    Raises:
        ValueError: the values or the cause do not match the template's fields.
    """

    source: str
    code: str
    values: tuple[Value, ...] = ()
    cause: "Reason | None" = None

    def __post_init__(self) -> None:
        expected = tuple(fields_of(self.code))
        if len(expected) - (_CAUSE in expected) != len(self.values) or (_CAUSE in expected) == (self.cause is None):
            raise ValueError(f"{self.code}: expected {expected}, got {self.values} and cause {self.cause}")

    def __str__(self) -> str:
        return f"{self.source}: {self.text}" if self.source else self.text

    @property
    def text(self) -> str:
        """The sentence without its source."""
        cause = {} if self.cause is None else {_CAUSE: self.cause.text}
        return TEMPLATES[self.code].format(**self._named, **cause)

    @property
    def kind(self) -> ReasonKind:
        """Identifies reasons that differ only in numbers."""
        words = (value for name, value in self._named.items() if isinstance(value, str) and name != _DETAIL)
        return ((self.source, self.code, *words), *(self.cause.kind if self.cause else ()))

    @property
    def stored(self) -> StoredReason:
        """The fields for a table or a message."""
        values = [str(value) for value in self.values]
        if self.cause is None:
            return {"source": self.source, "code": self.code, "values": values, "cause": ""}
        inner = self.cause.stored
        cause = _BETWEEN_CAUSES.join(code for code in (inner["code"], inner["cause"]) if code)
        return {"source": self.source, "code": self.code, "values": [*values, *inner["values"]], "cause": cause}

    @property
    def _named(self) -> dict[str, Value]:
        """The values by the names of the template's fields."""
        return dict(zip((name for name in fields_of(self.code) if name != _CAUSE), self.values, strict=True))


def reason_of(source: str, code: str, values: Iterable[str] = (), cause: str = "") -> Reason:
    """The reason of stored fields; with code ``other`` if they do not fit a code of ``TEMPLATES``."""
    codes = [code, *(cause.split(_BETWEEN_CAUSES, _MOST_CAUSES) if cause else ())]
    texts = list(values or ())
    try:
        return _reason_of(source, codes, texts)
    except (KeyError, TypeError, ValueError):
        return Reason(source or "", "other", (" ".join(map(str, (*codes, *texts))),))


def _reason_of(source: str, codes: Sequence[str], values: Sequence[str]) -> Reason:
    fields = {name: of for name, of in fields_of(codes[0]).items() if name != _CAUSE}
    own, rest = values[: len(fields)], values[len(fields) :]
    if rest and not codes[1:]:
        raise ValueError(f"{codes[0]}: expected {len(fields)} values, got {values}")
    cause = _reason_of(_CAUSE_SOURCE.get(codes[0], source), codes[1:], rest) if codes[1:] else None
    return Reason(source, codes[0], tuple(starmap(_value, zip(fields.values(), own, strict=True))), cause)


def _value(field: tuple[str, str], text: str) -> Value:
    """The value of a field from its text."""
    spec, conversion = field
    return text if conversion or not spec else int(text) if spec == "d" else float(text)


@cache
def fields_of(code: str) -> dict[str, tuple[str, str]]:
    """Format and conversion of each field of a template, by its name, in order."""
    parts = Formatter().parse(TEMPLATES[code])
    return {name: (spec or "", conversion or "") for _, name, spec, conversion in parts if name}


UNUSABLE: Final = frozenset(("undecodable", "wrong_size", "pair_of_wrong_size", "pair_of_two_sizes"))
"""The codes of messages that exist but cannot be used."""
