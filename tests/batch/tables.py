"""Tables of parts as tests make them: a true drive, of which each part sees some frames in an odom frame of its own."""

from dataclasses import fields

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from roadperc_stream.batch.joining import POSE, PartTables
from roadperc_stream.batch.splitting import SplitPart
from roadperc_stream.output.tables import arrow_schema
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics, ObjectMetrics

FACTS = {"roadperc.log_id": "part", "roadperc.source": "/logs/in.mcap", "roadperc.version": "1"}
STEP_NS = 100_000_000
NO_POSE = (None,) * 7


def drive(frames):
    """(frames, 4, 4) poses of a drive that turns, climbs and rolls."""
    k = np.arange(frames)
    poses = np.tile(np.eye(4), (frames, 1, 1))
    angles = np.stack([0.02 * k, 0.005 * np.sin(k / 3), 0.01 * np.cos(k / 5)], axis=1)
    poses[:, :3, :3] = Rotation.from_euler("zyx", angles).as_matrix()
    poses[:, :3, 3] = np.stack([1.1 * k, 0.3 * np.sin(k / 4), 0.02 * k], axis=1)
    return poses


def pose_row(pose):
    return (*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True))


def rows_of_poses(poses):
    """Rows of poses counted from the first of them."""
    return [pose_row(np.linalg.inv(poses[0]) @ pose) for pose in poses]


def frame_row(k, stamp_ns, pose=NO_POSE, **values):
    """The row of frame k; what is not given is null, or says that all is well."""
    row = {field.name: None for field in fields(FrameMetrics)} | dict.fromkeys(TIME_COLUMNS, 1.0)
    row |= {"log_id": "part", "frame": k, "stamp_ns": stamp_ns, "segment": 0, "missing": [], "reasons": []}
    row |= {"odometry_status": None if pose == NO_POSE else "tracked", "step_m": None if pose == NO_POSE else 1.0}
    return row | dict(zip(POSE, pose, strict=True)) | values


def object_row(k, stamp_ns, track_id, x_px, **values):
    """The row of a car of 40 x 20 pixels in frame k."""
    row = {field.name: None for field in fields(ObjectMetrics)}
    row |= {"log_id": "part", "frame": k, "stamp_ns": stamp_ns, "track_id": track_id, "label": "Car", "score": 0.9}
    row |= {"x_min_px": x_px, "y_min_px": 50.0, "x_max_px": x_px + 40.0, "y_max_px": 70.0}
    return row | {"kept": True, "status": "measured", "beyond_range": False} | values


def tables(index, frames, objects=(), shared=0):
    """A part's tables from its rows."""
    metrics = pa.Table.from_pylist(list(frames), schema=arrow_schema(FrameMetrics, TIME_COLUMNS, FACTS))
    found = pa.Table.from_pylist(list(objects), schema=arrow_schema(ObjectMetrics, metadata=FACTS))
    return PartTables(SplitPart(index, float(index) if index else None, None, shared), metrics, found)


def stamps(frames, first=0):
    return [1_000_000_000 + STEP_NS * (first + k) for k in range(frames)]


def part_of_drive(index, poses, begin, end, shared=0, **columns):
    """A part that has the frames from ``begin`` to ``end``, its path counted from its own first frame."""
    rows = rows_of_poses(poses[begin:end])
    return tables(
        index,
        [
            frame_row(k, stamp_ns, row, **{name: values[k] for name, values in columns.items()})
            for k, (stamp_ns, row) in enumerate(zip(stamps(end - begin, begin), rows, strict=True))
        ],
        shared=shared,
    )
