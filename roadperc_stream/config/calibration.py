"""Cameras that replace those of a log: the table ``calibration``, with the keys of ``calibration.json``."""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AliasChoices, BeforeValidator, FailFast, Field, PositiveInt

from roadperc_stream.config.fields import Section
from roadperc_stream.errors import DumpError
from roadperc_stream.schemas.role_names import role_of
from roadperc_stream.system.text import in_brief

LARGEST: Final = 1e9
"""Largest absolute number of a document: metres, pixels, degrees. Products of several such numbers are finite."""
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Numbers3 = tuple[Number, Number, Number]
Numbers4 = tuple[Number, Number, Number, Number]


def _rows(found: Any) -> Any:
    """Refuse values that are not rows, such as the nine numbers of a K in ROS."""
    if isinstance(found, (list, tuple)) and all(isinstance(row, (list, tuple)) for row in found):
        return found
    raise ValueError(f"expected 3 rows of numbers, [[...], [...], [...]], found {in_brief(found, 80)}")


Matrix3 = Annotated[tuple[Numbers3, Numbers3, Numbers3], BeforeValidator(_rows)]
Matrix34 = Annotated[tuple[Numbers4, Numbers4, Numbers4], BeforeValidator(_rows)]
FieldOfView = Annotated[float, Field(gt=0.0, lt=180.0)]
PositiveNumber = Annotated[Number, Field(gt=0.0)]
ImageSide = Annotated[PositiveInt, Field(le=1_000_000)]
_MOUNTING_KEYS: Final = frozenset(("mounting", "rgb_height_m", "depth_height_m"))


class Intrinsics(Section):
    """The size of a camera, and its K or horizontal field of view. The names of a lens are those of CameraInfo."""

    written_if_set = None

    width: ImageSide | None = None
    height: ImageSide | None = None
    K: Matrix3 | None = None
    D: Annotated[tuple[Number, ...], FailFast()] = ()
    distortion_model: str = "plumb_bob"
    R: Matrix3 | None = None
    P: Matrix34 | None = None
    fov_deg: FieldOfView | None = Field(None, validation_alias=AliasChoices("fov_deg", "fov"))


class CarlaPose(Section):
    """Position in metres and angles in degrees in CARLA's left-handed convention."""

    written_if_set = None

    x: Number = 0.0
    y: Number = 0.0
    z: Number
    roll: Number = 0.0
    pitch: Number = 0.0
    yaw: Number = 0.0


class CalibrationConfig(Intrinsics):
    """The cameras of a recording, and their mountings."""

    P_left: Matrix34 | None = None
    P_right: Matrix34 | None = None
    baseline_m: PositiveNumber | None = None
    pixel_origin: Literal["corner", "centre", "center"] = "corner"
    """Origin of K's principal point: the first pixel's corner (CARLA: c = w / 2) or its centre."""
    cameras: Mapping[str, Intrinsics] = {}
    """Cameras that differ from the front one, by role: ``{"depth": {"width": 800, "height": 600, "fov_deg": 90}}``."""
    mounting: Mapping[str, CarlaPose] = {}
    rgb_height_m: Number | None = None
    depth_height_m: Number | None = None

    def with_options(self, where: object, fov_deg: float | None, height_m: float | None) -> Self:
        """The calibration with a field of view instead of K and the lens, and a level camera at a height.

        Raises:
            DumpError: it has the camera's mounting already; the message begins with ``where``.
        """
        update: dict[str, Any] = {}
        if fov_deg is not None:
            update |= {"fov_deg": fov_deg, "K": None, "D": (), "R": None, "P": None}
        if height_m is not None:
            if any(role_of(name) in ("image", "left") for name in self.mounting):
                raise DumpError(f"{where} has the camera's mounting: remove it there, or remove --height")
            update |= {"rgb_height_m": height_m}
        return self.model_copy(update=update)

    def over(self, other: "CalibrationConfig") -> Self:
        """This calibration; if it says nothing of cameras or nothing of mountings, those of another one are added."""
        update: dict[str, Any] = {}
        for keys in (_MOUNTING_KEYS, type(self).model_fields.keys() - _MOUNTING_KEYS):
            if not self.model_fields_set & keys:
                update |= {name: getattr(other, name) for name in other.model_fields_set & keys}
        return self.model_copy(update=update)
