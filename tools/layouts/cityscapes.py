"""Cityscapes: ``leftImg8bit`` and ``gtFine``, with folders of splits and cities; the images are unrelated, 2 s apart.

``leftImg8bit/train/aachen/aachen_000000_000019_leftImg8bit.png`` belongs to
``gtFine/train/aachen/aachen_000000_000019_gtFine_labelIds.png``.
"""

from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError

from ..readers.frame_stamps import stamps_of_rate
from ..readers.sensor_folders import Sensor, with_headers
from ..rig import build_rig
from .dataset import DatasetSequence, Layout, Request

_IMAGES: Final = "leftImg8bit"
_LABELS: Final = ("gtFine", "gtCoarse")
_IDS: Final = {"cityscapes": "labelIds", "cityscapes-train-ids": "labelTrainIds"}
"""End of the names of the masks by the table of their tags."""
_DEPTHS: Final = ("*/*/", "*/", "")
_RATE_HZ: Final = 0.5


def _detect(folder: Path) -> bool:
    return (folder / _IMAGES).is_dir() and any((folder / name).is_dir() for name in _LABELS)


def _read(request: Request) -> DatasetSequence:
    """Read the images; ``--sequence`` chooses those whose path below ``leftImg8bit`` begins with it."""
    folder, options = request.folder, request.options
    wanted, rate_hz = options.sequence or "", options.rate_hz or _RATE_HZ
    table = options.tags or "cityscapes"
    images = [path for depth in _DEPTHS for path in sorted((folder / _IMAGES).glob(f"{depth}*_{_IMAGES}.*"))]
    chosen = [path for path in images if path.relative_to(folder / _IMAGES).as_posix().startswith(wanted)]
    if not chosen:
        raise DumpError(f"{folder}: no image {_IMAGES}/{wanted or 'SPLIT/CITY/'}*_{_IMAGES}.png")
    files = dict(enumerate(chosen))
    ids = _IDS.get(table, "labelIds")
    masks = {number: mask for number, path in files.items() if (mask := _mask(folder, path, ids))}
    sensors = {"image": Sensor("image", _IMAGES, files)}
    if masks:
        labels = dict.fromkeys(path.relative_to(folder).parts[0] for path in masks.values())
        sensors["segmentation"] = Sensor("segmentation", " and ".join(labels), masks)
    sensors = with_headers(sensors)
    sizes = {role: sensor.size for role, sensor in sensors.items() if sensor.size}
    rig = build_rig(*options.calibration_of(folder), list(sensors), sizes)
    request.notes.extend((*rig.notes, "the images are unrelated"))
    return DatasetSequence(
        title=f"Cityscapes, {wanted}" if wanted else "Cityscapes",
        sensors=sensors,
        stamps_ns=stamps_of_rate(list(files), rate_hz),
        timing=f"{rate_hz:g} Hz in the order of the names",
        rig=rig,
        tag_table=table,
    )


LAYOUT: Final = Layout(_read, ("--sequence", "--fov", "--calibration", "--height", "--rate", "--tags"), detect=_detect)


def _mask(folder: Path, image: Path, ids: str) -> Path | None:
    place, stem = image.parent.relative_to(folder / _IMAGES), image.name.rpartition(f"_{_IMAGES}")[0]
    masks = (folder / labels / place / f"{stem}_{labels}_{ids}.png" for labels in _LABELS)
    return next((mask for mask in masks if mask.is_file()), None)
