"""nuScenes: the tables of ``v1.0-*``, the front camera, the lidar on the roof, poses and boxes of one scene.

Stamps are microseconds. Each file has its own stamp and ego pose: an image that of its exposure's trigger, a sweep that
of its end. Boxes belong to the stamps of the samples, which are those of the lidar; between two samples they move at a
constant speed, as in ``NuScenes.get_boxes`` of nuscenes-devkit.
"""

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, TypeVar

import numpy as np
from pydantic import Field, TypeAdapter

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, inverse, rigid
from roadperc_stream.geometry.rotations import rotation_from_quaternion
from roadperc_stream.model.tag_tables import classes_of_label

from ..carla_dump.calibration_file import Matrix3, Positive, pinhole_of_K, require_pinhole
from ..carla_dump.camera_rig import LIDAR, Rig
from ..carla_dump.frame_stamps import mean_rate
from ..carla_dump.json_files import Document, Numbers3, Numbers4, checked, read_json
from ..carla_dump.layout import Sensor
from ..carla_dump.survey import surveyed
from ..carla_dump.truth_file import NO_TRUTH, TruthTables
from .boxes import LabelledBox, objects_of_boxes
from .drive import ConvertOptions, Drive, choose_sequence
from .front_rig import front_rig

_CHANNELS: Final = {"image": "CAM_FRONT", LIDAR: "LIDAR_TOP"}
_NEAREST_US: Final = 50_000
"""A box without a later or earlier sample of its object counts until this much before or after its sample."""
Microseconds = Annotated[int, Field(ge=0, lt=2**31 * 1_000_000)]


class _Row(Document):
    token: str = ""


class _Placed(_Row):
    translation: Numbers3
    rotation: Numbers4

    def pose(self) -> Float:
        """Return the (4, 4) pose; quaternions are w, x, y, z."""
        w, x, y, z = self.rotation
        return rigid(rotation_from_quaternion(x, y, z, w), np.array(self.translation))


class _Calibrated(_Placed):
    sensor_token: str
    camera_intrinsic: Matrix3 | tuple[()] = ()


class _Named(_Row):
    name: str


class _SensorRow(_Row):
    channel: str


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
    size: tuple[Positive, Positive, Positive]
    num_lidar_pts: int | None = None
    num_radar_pts: int | None = None


T = TypeVar("T", bound=_Row)


@dataclass(frozen=True)
class _Tables:
    folder: Path

    def rows(self, name: str, row: type[T]) -> list[T]:
        """Return the rows of a table; empty without its file."""
        path = self.folder / f"{name}.json"
        return checked(path, TypeAdapter(list[row]), read_json(path)) if path.is_file() else []  # type: ignore[valid-type]

    def by_token(self, name: str, row: type[T]) -> dict[str, T]:
        return {found.token: found for found in self.rows(name, row)}

    def look_up(self, name: str, rows: Mapping[str, T], token: str) -> T:
        if token not in rows:
            raise DumpError(f"{self.folder / name}.json: no row has the token {token!r}, which another table names")
        return rows[token]


def detect(folder: Path) -> bool:
    """Return True if the folder has the tables of a version."""
    return any(True for _ in folder.glob("v1.0-*/sample_data.json"))


def read(folder: Path, options: ConvertOptions) -> Drive:
    """Read one scene.

    Raises:
        DumpError: there is no such scene, or a table is wrong; the message names file, row and key.
    """
    options.require_only(folder, "--sequence")
    versions = {path.parent.name: path.parent for path in sorted(folder.glob("v1.0-*/sample_data.json"))}
    scenes = {row.name: path for path in versions.values() for row in _Tables(path).rows("scene", _Named)}
    name, version = choose_sequence(folder, scenes or versions, options.sequence)
    tables = _Tables(version)
    scene = next((row.token for row in tables.rows("scene", _Named) if row.name == name), None)
    samples = [s for s in tables.rows("sample", _Sample) if scene is None or s.scene_token == scene]
    notes: list[str] = []
    data = _data(tables, {sample.token for sample in samples}, notes)
    files = {role: {row.timestamp: folder / row.filename for row, _ in rows} for role, rows in data.items()}
    surveys = surveyed({role: Sensor(role, _CHANNELS[role], found) for role, found in files.items()})
    poses = tables.by_token("ego_pose", _Placed)
    world_T_ego = {r.timestamp: tables.look_up("ego_pose", poses, r.ego_pose_token).pose() for r, _ in data["image"]}
    size = surveys["image"].size
    assert size is not None  # headers of images have it
    rig = _rig(version, {role: rows[0][1] for role, rows in data.items()}, size)
    stamps_ns = {us: us * 1000 for us in sorted({us for found in files.values() for us in found})}
    return Drive(
        folder=folder,
        title=f"nuScenes, {name}",
        surveys=surveys,
        stamps_ns=stamps_ns,
        timing=f"stamps of sample_data.json (of exposures' triggers){mean_rate([us * 1000 for us in world_T_ego])}",
        rig=rig,
        stamps_of_sensors=True,
        poses=world_T_ego,
        truth=_truth(tables, rig, samples, world_T_ego, notes),
        pixel_origin="the first pixel's centre, as OpenCV has it",
        notes=tuple(notes),
    )


def _data(tables: _Tables, samples: set[str], notes: list[str]) -> dict[str, list[tuple[_Data, _Calibrated]]]:
    """Return the files of a scene by role, in order of their stamps, with the calibration of their sensor."""
    calibrated = tables.by_token("calibrated_sensor", _Calibrated)
    channels = {token: row.channel for token, row in tables.by_token("sensor", _SensorRow).items()}
    found: dict[str, list[tuple[_Data, _Calibrated]]] = {}
    for row in sorted(tables.rows("sample_data", _Data), key=lambda row: row.timestamp):
        if not samples or row.sample_token in samples:
            sensor = tables.look_up("calibrated_sensor", calibrated, row.calibrated_sensor_token)
            found.setdefault(channels.get(sensor.sensor_token, sensor.sensor_token), []).append((row, sensor))
    root = tables.folder.parent
    kept = {
        role: [(row, s) for row, s in found.pop(name, []) if (root / row.filename).is_file()]
        for role, name in _CHANNELS.items()
    }
    if not kept["image"]:
        raise DumpError(f"{tables.folder / 'sample_data.json'}: no file of {_CHANNELS['image']} exists in {root}")
    notes += [f"{', '.join(sorted(found))} are left out: CAM_FRONT is the front camera"] if found else []
    return {role: rows for role, rows in kept.items() if rows}


def _rig(version: Path, sensors: Mapping[str, _Calibrated], size: tuple[int, int]) -> Rig:
    where = f"{version / 'calibrated_sensor.json'}: camera_intrinsic of {_CHANNELS['image']}"
    K = np.array(sensors["image"].camera_intrinsic)
    if K.shape != (3, 3):
        raise DumpError(f"{where}: expected 3 rows of 3 numbers, found none")
    require_pinhole(where, K)
    ego_T_lidar = sensors[LIDAR].pose() if LIDAR in sensors else None
    return front_rig(where, size, pinhole_of_K(K, "centre"), sensors["image"].pose(), ego_T_lidar)


def _truth(
    tables: _Tables, rig: Rig, samples: Sequence[_Sample], world_T_ego: Mapping[int, Float], notes: list[str]
) -> TruthTables:
    """Return the boxes at the stamps of the images."""
    labels = _labels(tables)
    by_sample: dict[str, dict[str, _Annotation]] = {sample.token: {} for sample in samples}
    for box in tables.rows("sample_annotation", _Annotation):
        if box.sample_token in by_sample and (box.num_lidar_pts, box.num_radar_pts) != (0, 0):
            by_sample[box.sample_token][box.instance_token] = box
    keyframes = sorted((sample.timestamp, by_sample[sample.token]) for sample in samples if by_sample[sample.token])
    if not keyframes or not labels:
        notes.append("no true objects: the tables have no annotations, instances and categories of this scene")
        return NO_TRUTH
    boxes = {
        us: [
            LabelledBox(
                tables.look_up("instance", labels, token).name, inverse(pose) @ box.pose(), _length_first(box), token
            )
            for token, box in _boxes_at(keyframes, us)
        ]
        for us, pose in world_T_ego.items()
    }
    front = rig.cameras["calibration"]
    return objects_of_boxes(front, rig.transforms[0].parent_T_child, boxes)


def _labels(tables: _Tables) -> dict[str, _Named]:
    """Return the label of each instance: ``car`` for vehicle.car, ``pedestrian`` for human.pedestrian.adult."""
    categories = tables.by_token("category", _Named)
    labels = {}
    for token, row in tables.by_token("instance", _Instance).items():
        group, kind, *_ = (*tables.look_up("category", categories, row.category_token).name.split("."), "")
        known = kind if classes_of_label(kind) else ("vehicle" if group == "vehicle" else kind or group)
        labels[token] = _Named(name="pedestrian" if group == "human" else known)
    return labels


def _boxes_at(keyframes: Sequence[tuple[int, Mapping[str, _Annotation]]], us: int) -> Iterator[tuple[str, _Annotation]]:
    """Yield instance and box at a stamp; an object that only one of the two samples around it has is not moved."""
    after = bisect_right(keyframes, us, key=lambda frame: frame[0])
    (first_us, earlier), (second_us, later) = keyframes[max(after - 1, 0)], keyframes[min(after, len(keyframes) - 1)]
    for token in {**earlier, **later}:
        if token in earlier and token in later and first_us < second_us:
            yield token, _between(earlier[token], later[token], (us - first_us) / (second_us - first_us))
        else:
            box, stamp_us = (earlier[token], first_us) if token in earlier else (later[token], second_us)
            if abs(us - stamp_us) <= _NEAREST_US:
                yield token, box


def _between(a: _Annotation, b: _Annotation, share: float) -> _Annotation:
    """Return the box at a share of the time from a to b; the rotation is the normalised mean of the quaternions."""
    start, end = np.array(a.rotation), np.array(b.rotation)
    rotation = (1 - share) * start + share * (end if start @ end >= 0 else -end)
    translation = (1 - share) * np.array(a.translation) + share * np.array(b.translation)
    return a.model_copy(update={"rotation": tuple(rotation), "translation": tuple(translation)})


def _length_first(box: _Annotation) -> tuple[float, float, float]:
    width, length, height = box.size
    return length, width, height
