"""nuScenes: the tables of ``v1.0-*``, the front camera, the lidar on the roof, poses and boxes of one scene.

Stamps are microseconds. Each file has its own stamp and ego pose: an image that of its exposure's trigger, a sweep that
of its end. Boxes belong to the stamps of the samples, which are those of the lidar; between two samples they move at a
constant speed, as in ``NuScenes.get_boxes`` of nuscenes-devkit.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import hypot
from pathlib import Path
from typing import Annotated, Final, TypeVar

import numpy as np
from pydantic import AfterValidator, AliasChoices, Field, TypeAdapter

from roadperc_stream.config.calibration import Matrix3, Numbers3, Numbers4, PositiveNumber
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, inverse, rigid
from roadperc_stream.geometry.rotations import rotation_from_quaternion
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.model.tag_tables import classes_of_label

from ..readers.documents import Document, Listed, checked, named_file, read_json
from ..readers.frame_stamps import mean_rate
from ..readers.sensor_folders import Sensor, with_headers
from ..rig import front_rig
from .boxes import LabelledBox, objects_of_boxes
from .dataset import DatasetSequence, Layout, Request

_CHANNELS: Final = {"image": "CAM_FRONT", LIDAR: "LIDAR_TOP"}
_NEAREST_US: Final = 50_000
"""A box without a later or earlier sample of its object counts until this much before or after its sample."""
_UNIT_TOLERANCE: Final = 0.01
Microseconds = Annotated[int, Field(ge=0, lt=2**31 * 1_000_000)]


def _unit(wxyz: Numbers4) -> Numbers4:
    if abs(hypot(*wxyz) - 1) > _UNIT_TOLERANCE:
        raise ValueError("expected a rotation, a quaternion of length 1")
    return wxyz


Quaternion = Annotated[Numbers4, AfterValidator(_unit)]
"""w, x, y, z."""


class _Row(Document):
    token: str


class _Placed(_Row):
    translation: Numbers3
    rotation: Quaternion

    def pose(self) -> Float:
        """Return the (4, 4) pose in the parent frame."""
        w, x, y, z = self.rotation
        return rigid(rotation_from_quaternion(x, y, z, w), np.array(self.translation))


class _Calibrated(_Placed):
    sensor_token: str
    camera_intrinsic: Matrix3 | tuple[()] = ()


class _Named(_Row):
    """A scene, a category, or a sensor with its channel as name."""

    name: str = Field(validation_alias=AliasChoices("name", "channel"))


class _Data(_Row):
    sample_token: str = ""
    ego_pose_token: str
    calibrated_sensor_token: str
    timestamp: Microseconds
    filename: str


class _Sample(_Row):
    timestamp: Microseconds
    scene_token: str = ""


class _Instance(_Row):
    category_token: str


class _Annotation(_Placed):
    sample_token: str
    instance_token: str
    size: tuple[PositiveNumber, PositiveNumber, PositiveNumber]
    """Width, length, height."""
    num_lidar_pts: int | None = None
    num_radar_pts: int | None = None


T = TypeVar("T", bound=_Row)


class _Table(dict[str, T]):
    """The rows of a table by token; empty without its file."""

    def __init__(self, version: Path, name: str, row: type[T]) -> None:
        self.path = version / f"{name}.json"
        listed: TypeAdapter[list[T]] = TypeAdapter(Listed[row])  # type: ignore[valid-type]
        rows = checked(self.path, listed, read_json(self.path)) if self.path.is_file() else []
        super().__init__({found.token: found for found in rows})

    def __missing__(self, token: str) -> T:
        raise DumpError(f"{self.path}: no row has the token {token!r}, which another table names")


def _versions(folder: Path) -> dict[str, Path]:
    return {path.parent.name: path.parent for path in sorted(folder.glob("v1.0-*/sample_data.json"))}


def _sequences(folder: Path) -> dict[str, Path]:
    """Return the folder of the tables by scene, or by version if there is no table of scenes."""
    versions = _versions(folder)
    return {row.name: path for path in versions.values() for row in _scenes(path)} or versions


def _read(request: Request) -> DatasetSequence:
    folder, version, notes = request.folder, request.path, request.notes
    scene = next((row for row in _scenes(version) if row.name == request.name), None)
    samples = list(_Table(version, "sample", _Sample).values())
    if scene is not None:
        samples = [sample for sample in samples if sample.scene_token == scene.token]
    data = _data(version, {sample.token for sample in samples}, notes)
    mounts = _Table(version, "calibrated_sensor", _Calibrated)
    mounted = {role: mounts[rows[0].calibrated_sensor_token] for role, rows in data.items()}
    files = {role: {row.timestamp: folder / row.filename for row in rows} for role, rows in data.items()}
    sensors = with_headers({role: Sensor(role, _CHANNELS[role], found) for role, found in files.items()})
    poses = _Table(version, "ego_pose", _Placed)
    world_T_ego = {row.timestamp: poses[row.ego_pose_token].pose() for row in data["image"]}
    front = mounted["image"]
    rig = front_rig(
        f"{mounts.path}: camera_intrinsic of {front.token}",
        sensors["image"].size,
        np.array(front.camera_intrinsic),
        "centre",
        (front.pose(), mounted[LIDAR].pose() if LIDAR in mounted else None),
    )
    return DatasetSequence(
        title=f"nuScenes, {request.name}",
        sensors=sensors,
        stamps_ns={us: us * 1000 for us in sorted({us for found in files.values() for us in found})},
        timing=f"stamps of sample_data.json (of exposures' triggers){mean_rate([us * 1000 for us in world_T_ego])}",
        rig=rig,
        stamps_of_sensors=True,
        poses=world_T_ego,
        truth=objects_of_boxes(rig, _boxes(version, samples, world_T_ego, notes)),
        pixel_origin="the first pixel's centre, as OpenCV has it",
    )


LAYOUT: Final = Layout(_read, ("--sequence",), _sequences, lambda folder: bool(_versions(folder)))


def _scenes(version: Path) -> Iterable[_Named]:
    return _Table(version, "scene", _Named).values()


def _data(version: Path, samples: set[str], notes: list[str]) -> dict[str, list[_Data]]:
    """Return the existing files of a scene by role, in order of their stamps."""
    sensors, channels = _Table(version, "calibrated_sensor", _Calibrated), _Table(version, "sensor", _Named)
    table = _Table(version, "sample_data", _Data)
    found: dict[str, list[_Data]] = {}
    for row in sorted(table.values(), key=lambda row: row.timestamp):
        if not samples or row.sample_token in samples:
            channel = channels[sensors[row.calibrated_sensor_token].sensor_token].name
            found.setdefault(channel, []).append(row)
    used = {role: found.pop(name, []) for role, name in _CHANNELS.items()}
    kept = {role: [row for row in rows if _is_there(version, row)] for role, rows in used.items()}
    if not kept["image"]:
        raise DumpError(f"{table.path}: no file of {_CHANNELS['image']} exists in {version.parent}")
    notes += [f"{', '.join(sorted(found))} are left out: CAM_FRONT is the front camera"] if found else []
    if lost := sum(map(len, used.values())) - sum(map(len, kept.values())):
        notes.append(f"{lost} files of {table.path.name} do not exist")
    return {role: rows for role, rows in kept.items() if rows}


def _is_there(version: Path, row: _Data) -> bool:
    where = f"{version / 'sample_data.json'}: filename of {row.token}"
    return named_file(where, version.parent, row.filename) is not None


def _boxes(
    version: Path, samples: Sequence[_Sample], world_T_ego: Mapping[int, Float], notes: list[str]
) -> dict[int, list[LabelledBox]]:
    """Return the boxes at the stamps of the images."""
    by_sample: dict[str, dict[str, _Annotation]] = {sample.token: {} for sample in samples}
    for box in _Table(version, "sample_annotation", _Annotation).values():
        if box.sample_token in by_sample and (box.num_lidar_pts, box.num_radar_pts) != (0, 0):
            by_sample[box.sample_token][box.instance_token] = box
    if not any(by_sample.values()):
        notes.append("no true objects: sample_annotation.json has no boxes of this scene")
        return {}
    instances, categories = _Table(version, "instance", _Instance), _Table(version, "category", _Named)
    keyframes = [(row.timestamp, by_sample[row.token]) for row in sorted(samples, key=lambda row: row.timestamp)]
    boxes: dict[int, list[LabelledBox]] = {}
    for us, pose in world_T_ego.items():
        for box in _annotations_at(keyframes, us):
            label = _label(categories[instances[box.instance_token].category_token].name)
            width_m, length_m, height_m = box.size
            ego_T_box, size_m = inverse(pose) @ box.pose(), (length_m, width_m, height_m)
            boxes.setdefault(us, []).append(LabelledBox(label, ego_T_box, size_m, box.instance_token))
    return boxes


def _label(category: str) -> str:
    """Return ``car`` for vehicle.car, ``pedestrian`` for human.pedestrian.adult, ``barrier`` for its movable_object."""
    group, kind, *_ = (*category.split("."), "")
    if group == "human":
        return "pedestrian"
    return "vehicle" if group == "vehicle" and not classes_of_label(kind) else kind or group


def _annotations_at(keyframes: Sequence[tuple[int, Mapping[str, _Annotation]]], us: int) -> Iterator[_Annotation]:
    """Yield the boxes at a stamp; an object that only one of the two samples around it has is not moved."""
    after = bisect_right(keyframes, us, key=lambda frame: frame[0])
    (first_us, earlier), (second_us, later) = keyframes[max(after - 1, 0)], keyframes[min(after, len(keyframes) - 1)]
    for token in {**earlier, **later}:
        if token in earlier and token in later and first_us < second_us:
            yield _between(earlier[token], later[token], (us - first_us) / (second_us - first_us))
        elif abs(us - (first_us if token in earlier else second_us)) <= _NEAREST_US:
            yield {**later, **earlier}[token]


def _between(a: _Annotation, b: _Annotation, share: float) -> _Annotation:
    """Return the box at a share of the time from a to b; the rotation is the normalised mean of the quaternions."""
    start, end = np.array(a.rotation), np.array(b.rotation)
    rotation = (1 - share) * start + share * (end if start @ end >= 0 else -end)
    translation = (1 - share) * np.array(a.translation) + share * np.array(b.translation)
    return a.model_copy(update={"rotation": tuple(rotation), "translation": tuple(translation)})
