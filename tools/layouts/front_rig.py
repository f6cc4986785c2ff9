"""The rig of a dataset with one front camera and a lidar."""

from typing import Literal

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera, Float, pinhole_fault
from roadperc_stream.geometry.cameras import pinhole_of_K
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.input.projections import require_pinhole
from roadperc_stream.model import EGO, Transform

from ..carla_dump.survey import SensorSurvey
from ..rig import FRONT, Rig


def front_rig(
    where: str,
    images: SensorSurvey,
    K: Float,
    origin: Literal["corner", "centre"],
    mountings: tuple[Float, Float | None],
) -> Rig:
    """Return the rig of a front camera; its depth and tags have the same view.

    ``where`` is the file and key of K, (3, 3), whose principal point counts from the first pixel's ``origin``.
    ``mountings`` are (4, 4) ego_T_camera, and ego_T_lidar if there is a lidar.

    Raises:
        DumpError: K is not that of a camera with such images.
    """
    if K.shape != (3, 3):
        raise DumpError(f"{where}: expected 3 rows of 3 numbers, found {K.size} numbers")
    require_pinhole(where, K)
    size, pinhole = images.size or (0, 0), pinhole_of_K(K, origin)
    if fault := pinhole_fault(*size, *pinhole):
        raise DumpError(f"{where}: {fault}")
    edges = zip((FRONT, LIDAR), mountings, strict=True)
    transforms = tuple(Transform(EGO, frame, pose) for frame, pose in edges if pose is not None)
    return Rig({"calibration": Camera(FRONT, *size, *pinhole)}, {"depth": FRONT, LIDAR: LIDAR}, transforms)
