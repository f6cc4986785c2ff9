"""Random scenes: true objects that drive, and detections with errors, misses, false alarms and exchanged tracks."""

import numpy as np
import polars as pl

from roadperc_stream.output.tables import TableWriter
from roadperc_stream.schemas.columns import EXTRA_COLUMNS, FrameMetrics
from roadperc_stream.schemas.columns.places import TRUE_OBJECTS
from tests.eval.tables import START_NS, STEP_NS, object_rows

LABELS = {"vehicle": "Car", "pedestrian": "Pedestrian"}


def random_scene(seed):
    """For each class true objects and detections as frame, x, y, speed or None, track and, of detections, score."""
    rng = np.random.default_rng(seed)
    frames = int(rng.integers(5, 30))
    return {"frames": frames, "classes": {name: _of_class(rng, frames) for name in LABELS}}


def _of_class(rng, frames):
    true, found = [], []
    off_m, missed, false = rng.uniform(0.1, 1.5), rng.uniform(0, 0.5), rng.uniform(0, 2)
    objects = int(rng.integers(0, 6))
    starts, steps = rng.uniform((2, -4), (50, 4), (objects, 2)), rng.normal(0, 0.3, (objects, 2))
    tracks = list(range(objects))
    for frame in range(frames):
        if rng.random() < 0.1:
            rng.shuffle(tracks)
        for k in range(objects):
            if rng.random() < 0.1:
                continue
            place = starts[k] + frame * steps[k]
            true.append((frame, *place.tolist(), float(rng.normal(5, 2)), k))
            if rng.random() >= missed:
                speed = None if rng.random() < 0.2 else float(rng.normal(5, 2))
                score = float(np.round(rng.random(), 2))  # some are equal
                found.append((frame, *(place + rng.normal(0, off_m, 2)).tolist(), speed, tracks[k], score))
        for _ in range(rng.poisson(false)):
            place = rng.uniform((2, -4), (50, 4)).tolist()
            found.append((frame, *place, None, 100 + int(rng.integers(0, 3)), float(rng.random() * 0.6)))
    return true, _once_a_frame(found)


def _once_a_frame(found):
    """The detections without those whose track the frame has already."""
    return list({(row[0], row[4]): row for row in found}.values())


def write_scene(folder, scene, name="out", **more):
    """The two tables of a scene; returns that of the frames. ``more`` has columns of true objects by frame."""
    path = folder / f"{name}.metrics.parquet"
    extra = (*EXTRA_COLUMNS, TRUE_OBJECTS)
    with TableWriter(path, FrameMetrics, {"roadperc.config_digest": "c" * 64}, extra) as table:
        for frame in range(scene["frames"]):
            lists = [_true(row, LABELS[kind]) for kind, of in scene["classes"].items() for row in of[0]]
            own = [item for at, item in lists if at == frame]
            row = FrameMetrics("a" * 16, frame, START_NS + frame * STEP_NS)
            table.append(row, total_ms=1.0, true_objects=[item | more for item in own])
    rows = [(*row, LABELS[kind]) for kind, of in scene["classes"].items() for row in of[1]]
    columns = ("frame", "x_m", "y_m", "closing_speed_mps", "track_id", "score", "label")
    kinds = dict(zip(columns, (pl.Int64, *[pl.Float64] * 3, pl.Int64, pl.Float64, pl.String), strict=True))
    found = pl.DataFrame(rows, kinds, orient="row").sort("frame", maintain_order=True)
    found = found.with_columns(pl.col("track_id").cast(pl.String), kept=pl.lit(value=True))
    object_rows({name: found[name] for name in found.columns}).write_parquet(folder / f"{name}.objects.parquet")
    return path


def _true(row, label):
    frame, x_m, y_m, speed, track = row
    place = {"id": f"id {track}", "label": label, "x_m": x_m, "y_m": y_m, "closing_speed_mps": speed}
    return frame, place | {"time_to_impact_s": None, "in_path": None, "detected": False}
