"""The tables of a log's parts, that were replayed at once, as those of one pass.

Two parts that follow each other have some frames in common. Rows are the earlier part's up to the middle of those, the
seam, and the later one's behind it: there nothing is cut off that a frame needs. What counts from the start goes on at
the seam: numbers of frames and segments, changes of lane, the path. An object that both parts see in a frame is one.

Where the stamps go back or stand still the chain begins anew (``chain.step``), in one pass as in a part: such a stretch
is as the part has it, and only what lies in the same stretch as the seam is made to go on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from roadperc_stream.batch.path_joining import PartPath, PathMap, path_map
from roadperc_stream.batch.splitting import SplitPart
from roadperc_stream.batch.track_joining import TrackedBox, joined_names, largest_number, renamed
from roadperc_stream.core.datatypes import Box
from roadperc_stream.errors import TableError
from roadperc_stream.output.tables import FACT_PREFIX
from roadperc_stream.schemas.record import LOG_ID_KEY

POSE: Final = ("odom_x_m", "odom_y_m", "odom_z_m", "odom_qx", "odom_qy", "odom_qz", "odom_qw")
"""The pose's columns."""
_BOX: Final = ("x_min_px", "y_min_px", "x_max_px", "y_max_px")
_KNOWN: Final = ("first", "tracked")
"""Status of odometry in a frame whose pose is its own, and not that of an earlier one."""
_AROUND: Final = 16
"""By how many more or fewer frames than expected two parts may overlap: single messages make no frame."""

Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PartTables:
    """A part of a log, and the tables of its replay."""

    part: SplitPart
    metrics: pa.Table
    objects: pa.Table


@dataclass(frozen=True)
class JoinedTables:
    """The tables of a whole log, and what its user should know of how they were joined."""

    metrics: pa.Table
    objects: pa.Table
    notes: tuple[str, ...] = ()


def join(log_id: str, parts: Sequence[PartTables]) -> JoinedTables:
    """The tables of all parts as those of one log: columns, their order and the footers' facts are as in one pass.

    Args:
        log_id: of the whole log; each part's tables have their own.
        parts: all parts in their order.

    Raises:
        TableError: a part has no frame in common with the one before, or other columns.
    """
    before, *others = (_Stretch.of(part) for part in parts)
    whole, notes, begin = [], list[str](), 0
    for stretch in others:
        _require_alike(before, stretch)
        seam = _seam(before, stretch)
        after, note = _going_on(before, stretch, seam)
        whole.append(before.rows(begin, seam.before + 1))
        before, begin = after, seam.after + 1
        notes += [f"{stretch.name}: {note}"] if note else []
    whole.append(before.rows(begin, before.frames))
    metrics, objects = (pa.concat_tables(tables) for tables in zip(*whole, strict=True))
    return JoinedTables(_named(metrics, log_id), _named(objects, log_id), tuple(notes))


def _named(table: pa.Table, log_id: str) -> pa.Table:
    """The table with the whole log's id in its rows and among its facts; the others are the first part's."""
    facts = {**(table.schema.metadata or {}), f"{FACT_PREFIX}{LOG_ID_KEY}".encode(): log_id.encode()}
    return _with(table, {"log_id": pa.array([log_id] * len(table), pa.string())}).replace_schema_metadata(facts)


def _with(table: pa.Table, columns: Mapping[str, Any]) -> pa.Table:
    """The table with other values in some columns."""
    for name, values in columns.items():
        at = table.schema.get_field_index(name)
        table = table.set_column(at, table.schema.field(at), values)
    return table


@dataclass(frozen=True)
class _Stretch:
    """A part's tables, with its frames' stamps, and how often the chain had begun anew at each of them.

    ``largest_track`` is the largest number of a track in the parts before, since the chain last began anew there; in
    this part that goes on as far as ``eras`` are ``era``.
    """

    part: SplitPart
    metrics: pa.Table
    objects: pa.Table
    stamps_ns: Rows
    eras: Rows
    era: int = 0
    largest_track: int = 0

    @classmethod
    def of(cls, tables: PartTables) -> "_Stretch":
        stamps_ns = tables.metrics["stamp_ns"].to_numpy()
        anew = np.diff(stamps_ns, prepend=stamps_ns[:1] - 1) <= 0
        return cls(tables.part, tables.metrics, tables.objects, stamps_ns, np.cumsum(anew))

    @property
    def name(self) -> str:
        return f"part {self.part.index + 1}, from {self.part.start_s or 0.0:g} s on"

    @property
    def frames(self) -> int:
        return len(self.stamps_ns)

    @property
    def first_frame(self) -> int:
        return int(self.metrics["frame"][0].as_py()) if self.frames else 0

    def object_rows(self) -> Rows:
        """The row of each object's frame."""
        return np.asarray(self.objects["frame"].to_numpy() - self.first_frame, np.int64)

    def rows(self, begin: int, end: int) -> tuple[pa.Table, pa.Table]:
        """The rows of some frames, and those of their objects."""
        rows = self.object_rows()
        return self.metrics.slice(begin, end - begin), self.objects.filter(pa.array((rows >= begin) & (rows < end)))

    def largest_track_in(self, era: int) -> int:
        """The largest number of a track that there has been since an era began."""
        here = pa.array(self.eras[self.object_rows()] == era)
        return max(
            largest_number(self.objects["track_id"].filter(here).to_pylist()), self.largest_track * (era == self.era)
        )

    def path_in(self, era: int) -> PartPath:
        """The path as far as it is of one era."""
        here = self.eras == era
        status = self.metrics["odometry_status"]
        known = pc.fill_null(pc.is_in(status, pa.array(_KNOWN)), fill_value=False).to_numpy()
        poses = np.where(here[:, None], self.poses(), np.nan)
        return PartPath(poses, known & np.isfinite(poses).all(axis=1), self.metrics["step_m"].null_count < self.frames)

    def poses(self) -> NDArray[np.float64]:
        """(N, 7) poses, NaN where there is none."""
        return np.stack([self.metrics[name].to_numpy() for name in POSE], axis=1)

    def tracked_in(self, row: int) -> list[TrackedBox]:
        """Where the tracks are in a frame."""
        found = self.objects.filter(pa.array(self.object_rows() == row))
        columns = (found[name].to_pylist() for name in ("track_id", "label", *_BOX))
        return [
            TrackedBox(name, label, Box(*box)) for name, label, *box in zip(*columns, strict=True) if name is not None
        ]


@dataclass(frozen=True)
class _Seam:
    """The last frame that is taken of the part before, by its row there and its row in the part behind.

    ``common`` (N, 2) are the rows of all frames that both have since the chain last began anew, this one first, then
    the nearest ones to it.
    """

    before: int
    after: int
    common: Rows


def _require_alike(before: _Stretch, after: _Stretch) -> None:
    for ours, theirs in ((before.metrics, after.metrics), (before.objects, after.objects)):
        if not ours.schema.equals(theirs.schema):
            raise TableError(f"{after.name}: expected the columns of the part before, found others")


def _seam(before: _Stretch, after: _Stretch) -> _Seam:
    """Where a part goes on from the one before.

    The stamps of a log that was played in a loop come again, so it is the overlap nearest to the expected one.

    Raises:
        TableError: no frame is in both.
    """
    expected = after.part.shared_frames
    overlaps = range(1, min(before.frames, after.frames, 2 * expected + _AROUND) + 1)
    for overlap in sorted(overlaps, key=lambda frames: abs(frames - expected)):
        same = before.stamps_ns[before.frames - overlap :] == after.stamps_ns[:overlap]
        if 2 * np.sum(same) >= overlap:
            return _seam_of(before, after, before.frames - overlap, np.flatnonzero(same))
    raise TableError(f"{after.name}: expected {expected} frames that the part before has too, found none")


def _seam_of(before: _Stretch, after: _Stretch, shift: int, same: Rows) -> _Seam:
    """The seam in the middle of the frames that are the same, by their rows in the part behind."""
    middle = int(same[len(same) // 2])
    in_era = (after.eras[same] == after.eras[middle]) & (before.eras[same + shift] == before.eras[middle + shift])
    near = sorted(same[in_era].tolist(), key=lambda row: abs(row - middle))
    return _Seam(middle + shift, middle, np.array([(row + shift, row) for row in near], np.int64))


def _going_on(before: _Stretch, after: _Stretch, seam: _Seam) -> tuple[_Stretch, str]:
    """A part as it goes on from the one before, which does so already; and what there is to say of it."""
    eras = int(before.eras[seam.before]), int(after.eras[seam.after])
    in_era = np.asarray(after.eras == eras[1])
    more_frames = before.first_frame + seam.before - seam.after - after.first_frame
    found = path_map(before.path_in(eras[0]), after.path_in(eras[1]), seam.common)
    names = _track_names(before, after, seam, before.largest_track_in(eras[0]))
    metrics = _with(
        after.metrics,
        {
            "frame": pc.add(after.metrics["frame"], more_frames),
            "segment": pc.add(after.metrics["segment"], _more(before, after, seam, "segment")),
            "lane_changes": _lane_changes(before, after, seam, in_era),
            **_path_columns(after.poses(), in_era, found),
        },
    )
    tracks = renamed(after.objects["track_id"].to_pylist(), in_era[after.object_rows()].tolist(), names)
    objects = _with(
        after.objects,
        {"frame": pc.add(after.objects["frame"], more_frames), "track_id": pa.array(tracks, pa.string())},
    )
    largest = max(before.largest_track_in(eras[0]), largest_number(names.values()))
    return replace(after, metrics=metrics, objects=objects, era=eras[1], largest_track=largest), found.note


def _more(before: _Stretch, after: _Stretch, seam: _Seam, column: str) -> int:
    """By how much a count is larger in the whole log than in a part: by the frame nearest to the seam that tells."""
    counts = (stretch.metrics[column].to_pylist() for stretch in (before, after))
    ours, theirs = (dict(enumerate(values)) for values in counts)
    both = ((ours[i], theirs[j]) for i, j in seam.common.tolist())
    return next((one - other for one, other in both if one is not None and other is not None), 0)


def _lane_changes(before: _Stretch, after: _Stretch, seam: _Seam, in_era: Mask) -> Any:
    counts = after.metrics["lane_changes"]
    return pc.if_else(pa.array(in_era), pc.add(counts, _more(before, after, seam, "lane_changes")), counts)


def _path_columns(poses: NDArray[np.float64], in_era: Mask, found: PathMap) -> dict[str, Any]:
    """The columns of the pose, mapped as far as they are of the seam's stretch; where there is none they stay null."""
    mapped = np.where(in_era[:, None], found.applied(poses), poses)
    return {name: pa.array(mapped[:, k], from_pandas=True) for k, name in enumerate(POSE)}


def _track_names(before: _Stretch, after: _Stretch, seam: _Seam, largest: int) -> dict[str, str]:
    """The name in the whole log of each track that a part has in the seam's stretch."""
    common = ((before.tracked_in(i), after.tracked_in(j)) for i, j in seam.common.tolist())
    here = pa.array((after.eras == after.eras[seam.after])[after.object_rows()])
    names = pc.drop_null(after.objects["track_id"].filter(here)).to_pylist()
    return joined_names(common, names, largest)
