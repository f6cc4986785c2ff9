"""The true objects and the kept detections of frames, by class, with their matches."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Final, Self

import numpy as np
import polars as pl

from roadperc_stream.geometry import Float
from roadperc_stream.model.tag_tables import classes_of_label, normal_label
from roadperc_stream.schemas.columns.places import OBJECT_PLACE, TRUE_OBJECTS

from ..dataset.reading import reading_files
from ..report.sources import FrameSource
from .matching import MATCHES_M, Codes, Mask, Pairs, by_score, greedy, near_pairs
from .tracks import LEAST_SIMILARITY, Sighted, clear_matches, hota_matches, similarity, switches

AT: Final = "at"
"""The number of a frame, from 0."""
SEQUENCE: Final = "sequence"
"""The number of a segment of a log, in which ids name objects."""
ERRORS_AT: Final = MATCHES_M.index(2.0)
"""The match whose errors count, as in nuScenes."""
_CLASS: Final = "class"
_TRACK: Final = "track"
_OF_TRUTH: Final = ("x_m", "y_m", "closing_speed_mps", "time_to_impact_s")


@dataclass(frozen=True)
class Rows:
    """Arrays with a row for each object; ``frame`` is the number of its frame."""

    frame: Codes

    def within(self, frames: Mask) -> Self:
        """The rows of some frames, by a mask over all frames."""
        kept = frames[self.frame]
        return self if kept.all() else replace(self, **{f.name: getattr(self, f.name)[kept] for f in fields(self)})


@dataclass(frozen=True)
class Truths(Rows):
    """True objects with a place: their distance on the ground, and their matches as tracks.

    ``matched`` and ``switched`` are those of MOTA. ``hota_track`` is the matched track of HOTA, -1 without one, and
    ``alike`` their similarity.
    """

    reach_m: Float
    track: Codes
    matched: Mask
    switched: Mask
    hota_track: Codes
    alike: Float


@dataclass(frozen=True)
class Detections(Rows):
    """Kept detections with a place, by falling score.

    ``hit`` (N, 4) tells whether it hits a true object within each of ``MATCHES_M``. ``reach_m`` (N, 4) is the distance
    of that object on the ground, else its own. ``off_m`` and ``off_mps`` are the errors of the hit within 2 m.
    """

    track: Codes
    score: Float
    hit: Mask
    reach_m: Float
    off_m: Float
    off_mps: Float


@dataclass(frozen=True)
class Likely(Rows):
    """The pairs of a true object and a detection that are similar enough for the same object."""

    true_track: Codes
    track: Codes
    sequence: Codes


@dataclass(frozen=True)
class Impacts(Rows):
    """True objects in the path: their true time to impact, and whether a detection of their frame matches them."""

    time_s: Float
    detected: Mask


@dataclass(frozen=True)
class OfClass:
    """The objects of one class."""

    truths: Truths
    found: Detections
    likely: Likely


@dataclass(frozen=True)
class Scene:
    """The objects of frames by class; ``has_tracks`` is false if no true object has an id."""

    classes: Mapping[str, OfClass]
    impacts: Impacts
    has_tracks: bool

    def within(self, frames: Mask) -> "Scene":
        """The objects of some frames, by a mask over all frames."""
        classes = {
            name: OfClass(*(getattr(of, part.name).within(frames) for part in fields(of)))
            for name, of in self.classes.items()
        }
        return Scene(classes, self.impacts.within(frames), self.has_tracks)


def read_scene(source: FrameSource, frames: pl.DataFrame) -> Scene | None:
    """The objects of some frames of a source; None without true objects or a table of objects.

    Tables of older versions have neither.

    Args:
        source: the rows of the tables.
        frames: the keys of the source, ``frame``, ``AT`` in rising order and ``SEQUENCE``.

    Raises:
        TableError: a table cannot be read.
    """
    lists = _true_lists(source, frames)
    found = None if lists is None else _read_found(source, frames.filter(pl.col(AT).is_in(lists[AT].implode())))
    if lists is None or found is None:
        return None
    truth = lists.filter(pl.col(TRUE_OBJECTS).list.len() > 0).explode(TRUE_OBJECTS).unnest(TRUE_OBJECTS)
    truth = truth.with_columns(pl.col(_OF_TRUTH).cast(pl.Float64), _class_of())
    ids, placed = bool((truth["id"] != "").any()), truth.filter(pl.col("x_m").is_finite())
    truths, founds = _with_tracks(placed, "id"), _with_tracks(found, "track_id")
    classes = {
        name: _of_class(*(rows.filter(pl.col(_CLASS) == name) for rows in (truths, founds)))
        for name in sorted({*truths[_CLASS], *founds[_CLASS]})
    }
    ahead = truth.filter("in_path", pl.col("time_to_impact_s").is_finite())
    impacts = Impacts(*(ahead[name].to_numpy() for name in (AT, "time_to_impact_s", "detected")))
    return Scene(classes, impacts, ids)


def _true_lists(source: FrameSource, frames: pl.DataFrame) -> pl.DataFrame | None:
    """The true objects of each frame that has such truth, in the order of the frames; None without any."""
    if TRUE_OBJECTS not in source.rows.collect_schema():
        return None
    lists = source.rows.join(frames.lazy(), on=[*source.keys, "frame"], how="inner")
    with reading_files(source.files):
        rows = lists.select(AT, SEQUENCE, TRUE_OBJECTS).drop_nulls(TRUE_OBJECTS).sort(AT).collect()
    return rows if rows.height else None


def _read_found(source: FrameSource, frames: pl.DataFrame) -> pl.DataFrame | None:
    """A row for each kept detection with a place, in the order of the frames."""
    numbers = ("x_m", "y_m", "score", "closing_speed_mps")
    if source.objects is None or not {*OBJECT_PLACE} <= {*source.objects.collect_schema()}:
        return None
    rows = source.objects.filter("kept", pl.col("x_m").is_finite())
    rows = rows.join(frames.lazy(), on=[*source.keys, "frame"], how="inner")
    texts = (pl.col(name).cast(pl.String) for name in ("track_id", "label"))
    with reading_files(source.object_files):
        found = rows.select(AT, SEQUENCE, *texts, pl.col(numbers).cast(pl.Float64)).collect()
    return found.with_columns(_class_of()).sort(AT, maintain_order=True)


def _class_of() -> pl.Expr:
    """The class of a label: the first one of the table of classes, else the label in its normal form."""
    return (
        pl.col("label")
        .map_elements(lambda label: (classes_of_label(label) or (normal_label(label),))[0], pl.String)
        .alias(_CLASS)
    )


def _with_tracks(rows: pl.DataFrame, name: str) -> pl.DataFrame:
    """The rows with a number for each track; an object without an id is a track of its own."""
    own = pl.when(pl.col(name).fill_null("") == "").then(pl.format("{} alone", pl.int_range(pl.len())))
    track = pl.format("{} {} {}", SEQUENCE, _CLASS, own.otherwise(name)).rank("dense").cast(pl.Int64) - 1
    return rows.with_columns(track.alias(_TRACK))


def _of_class(truth: pl.DataFrame, found: pl.DataFrame) -> OfClass:
    """The matches of the objects of one class."""
    (frame, track, sequence), (own_frame, own_track) = (
        [rows[name].to_numpy() for name in names]
        for rows, names in ((truth, (AT, _TRACK, SEQUENCE)), (found, (AT, _TRACK)))
    )
    true_m, place_m = (rows.select(OBJECT_PLACE).to_numpy().reshape(-1, 2) for rows in (truth, found))
    pairs = near_pairs(frame, true_m, own_frame, place_m)
    score = found["score"].to_numpy()
    hits = np.stack([greedy(pairs, own_frame, score, limit_m) for limit_m in MATCHES_M], axis=1)
    of = _errors(truth, found, hits[:, ERRORS_AT])
    reach_m, own_m = (np.hypot(*places.T) for places in (true_m, place_m))
    reaches_m = np.where(hits >= 0, np.append(reach_m, 0.0)[hits], own_m[:, None])
    true, own = Sighted(frame, track), Sighted(own_frame, own_track)
    i, k, alike = alike_pairs = Pairs(pairs.true, pairs.found, similarity(pairs.value))
    best, match = hota_matches(alike_pairs, true, own), clear_matches(alike_pairs, true, own)
    hota_track, hota_alike = np.full(len(frame), -1), np.zeros(len(frame))
    hota_track[i[best]], hota_alike[i[best]] = own_track[k[best]], alike[best]
    near, falling = alike >= LEAST_SIMILARITY, by_score(score)
    return OfClass(
        Truths(frame, reach_m, track, match >= 0, switches(match, true, own), hota_track, hota_alike),
        Detections(*(column[falling] for column in (own_frame, own_track, score, hits >= 0, reaches_m, *of))),
        Likely(frame[i[near]], track[i[near]], own_track[k[near]], sequence[i[near]]),
    )


def _errors(truth: pl.DataFrame, found: pl.DataFrame, hits: Codes) -> Iterator[Float]:
    """(N,) distance on the ground and difference of the closing speed from the true object that is hit, NaN unknown."""
    names = (*OBJECT_PLACE, "closing_speed_mps")
    true, own = (rows.select(names).to_numpy().reshape(-1, 3).astype(float) for rows in (truth, found))
    x_m, y_m, off_mps = (own - np.vstack((true, np.full(3, np.nan)))[hits]).T
    yield np.hypot(x_m, y_m)
    yield np.abs(off_mps)
