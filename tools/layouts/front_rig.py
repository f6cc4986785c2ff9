"""The rig of a dataset with one front camera and a lidar."""

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera, Float, pinhole_fault
from roadperc_stream.model import EGO, Transform

from ..carla_dump.calibration_file import Pinhole
from ..carla_dump.camera_rig import FRONT, LIDAR, Rig, Size


def front_rig(where: str, size: Size, pinhole: Pinhole, ego_T_camera: Float, ego_T_lidar: Float | None) -> Rig:
    """Return the rig of a camera with ``size`` columns and rows; its depth and tags have the same view.

    Raises:
        DumpError: the pinhole does not fit the images; the message starts with ``where``.
    """
    if fault := pinhole_fault(*size, *pinhole):
        raise DumpError(f"{where}: {fault}")
    mountings = {FRONT: ego_T_camera, LIDAR: ego_T_lidar}
    transforms = tuple(Transform(EGO, frame, pose) for frame, pose in mountings.items() if pose is not None)
    return Rig({"calibration": Camera(FRONT, *size, *pinhole)}, {"depth": FRONT, LIDAR: LIDAR}, transforms)
