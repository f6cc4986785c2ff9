"""The figures of detections and tracks over sets of frames, and what each frame contributes to them."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Final

import numpy as np
import polars as pl

from roadperc_stream.geometry import Float

from ..report.sources import RUN, Frames, Numbers, source_of_runs
from ..report.summaries import Groups
from ..runs import Run
from ..scan import SEGMENT
from .detection import average_precision, curves, mean_error
from .matching import MATCHES_M, Mask
from .scene import AT, ERRORS_AT, SEQUENCE, Detections, OfClass, Scene, read_scene
from .tracks import TrackSums, association, identity_matches

RINGS_M: Final = {"": (0.0, inf), "0-20m": (0.0, 20.0), "20-40m": (20.0, 40.0), "over-40m": (40.0, inf)}
"""Distances on the ground from the ego origin by name: all, and those by which objects are also judged apart."""
BANDS_S: Final = {"0-1s": (0.0, 1.0), "1-2s": (1.0, 2.0), "2-3s": (2.0, 3.0), "3-5s": (3.0, 5.0)}
"""Times to impact by name, by which missed objects in the path are counted."""
_MOST_PARTS: Final = 100
"""Most series of frames, over all logs: each one costs an evaluation of its log."""
_FEWEST_PARTS: Final = 40
_MOST_ROWS: Final = 1_000_000
"""With more detections than this in all evaluations of a log, there are fewer parts."""
_AT_ONCE: Final = 200_000
"""Frames of logs whose objects are in memory at a time; a log is not divided."""


@dataclass(frozen=True)
class ObjectTally:
    """What the figures follow from; the tallies of several logs can be added.

    ``truths`` counts the true objects by class and ring, ``found`` has the detections by class. ``impacts`` counts the
    true objects of each of ``BANDS_S``, and ``detected`` those with a detection. ``tracks`` is empty without ids.
    """

    truths: Counter[tuple[str, str]] = field(default_factory=Counter)
    found: Mapping[str, tuple[Detections, ...]] = field(default_factory=dict)
    impacts: Counter[str] = field(default_factory=Counter)
    detected: Counter[str] = field(default_factory=Counter)
    tracks: TrackSums = field(default_factory=TrackSums)

    def __add__(self, other: "ObjectTally") -> "ObjectTally":
        """The tally over both."""
        names = dict.fromkeys((*self.found, *other.found))
        return ObjectTally(
            self.truths + other.truths,
            {name: (*self.found.get(name, ()), *other.found.get(name, ())) for name in names},
            self.impacts + other.impacts,
            self.detected + other.detected,
            self.tracks + other.tracks,
        )

    @property
    def classes(self) -> list[str]:
        """The classes with true objects."""
        return sorted({name for name, _ in self.truths})


@dataclass(frozen=True)
class Detected:
    """How well objects of a class are detected in a ring: average precision within each of ``MATCHES_M``.

    ``curve`` is the (101,) precision within 2 m at each recall. ``off_m`` and ``off_mps`` are nuScenes' errors of
    translation and velocity, the latter of the closing speed.
    """

    true: int
    precision: tuple[float, ...]
    curve: Float
    off_m: float
    off_mps: float

    @property
    def mean(self) -> float:
        """The mean over the distances of a match."""
        return float(np.mean(self.precision))


def detected(tally: ObjectTally, name: str, ring: str = "") -> Detected | None:
    """How well the objects of a class are detected in a ring; None without true objects there.

    A detection that hits a true object counts in the ring of that object.
    """
    true = tally.truths[name, ring]
    parts = tally.found.get(name, ())
    if not true:
        return None
    names = ("score", "hit", "reach_m", "off_m", "off_mps")
    score, hit, reach_m, off_m, off_mps = (np.concatenate([getattr(part, of) for part in parts]) for of in names)
    if len(parts) > 1:
        falling = np.argsort(-score, kind="stable")
        score, hit, reach_m, off_m, off_mps = (of[falling] for of in (score, hit, reach_m, off_m, off_mps))
    inside = _between(reach_m, RINGS_M[ring])
    precision = []
    for at in range(len(MATCHES_M)):
        rows = inside[:, at]
        at_recall, confidence = curves(score[rows], hit[rows, at], true)
        precision.append(average_precision(at_recall))
        if at == ERRORS_AT:
            hits, curve = rows & hit[:, at], at_recall
            errors = [mean_error(error[hits], score[hits], confidence) for error in (off_m, off_mps)]
    return Detected(true, tuple(precision), curve, *errors)


def tally_of(scene: Scene) -> ObjectTally:
    """The tally of a scene."""
    truths = {
        (name, ring): int(_between(of.truths.reach_m, ring_m).sum())
        for name, of in scene.classes.items()
        for ring, ring_m in RINGS_M.items()
    }
    in_band = {band: _between(scene.impacts.time_s, band_s) for band, band_s in BANDS_S.items()}
    return ObjectTally(
        +Counter(truths),  # without those that are 0
        {name: (of.found,) for name, of in scene.classes.items()},
        +Counter({band: int(rows.sum()) for band, rows in in_band.items()}),
        +Counter({band: int((rows & scene.impacts.detected).sum()) for band, rows in in_band.items()}),
        sum(map(_track_sums, scene.classes.values()), TrackSums()) if scene.has_tracks else TrackSums(),
    )


def _between(values: Float, limits: tuple[float, float]) -> Mask:
    return (values >= limits[0]) & (values < limits[1])


def _track_sums(of: OfClass) -> TrackSums:
    truths, found = of.truths, of.found
    matched = truths.hota_track >= 0
    own, other = truths.track[matched], truths.hota_track[matched]
    lengths = np.bincount(truths.track)[own] + _count(found.track, other)
    return TrackSums(
        len(truths.frame),
        len(found.frame),
        *association(own, other, truths.alike[matched], lengths),
        int(np.count_nonzero(truths.matched)),
        int(np.count_nonzero(truths.switched)),
        identity_matches(of.likely.true_track, of.likely.track, of.likely.sequence),
    )


def _count(track: Numbers, of: Numbers) -> Numbers:
    """The number of rows with each of some tracks."""
    return np.bincount(track, minlength=int(of.max(initial=0)) + 1)[of]


def figures(tally: ObjectTally) -> Iterator[tuple[str, float]]:
    """The judged figures with a value, by name: those of classes are averaged as in nuScenes."""
    for ring in RINGS_M:
        by_class = {name: found for name in tally.classes if (found := detected(tally, name, ring))}
        if not by_class:
            continue
        yield f"objects_ap.{ring}".rstrip("."), float(np.mean([found.mean for found in by_class.values()]))
        if not ring:
            yield from ((f"objects_ap.{name}", found.mean) for name, found in by_class.items())
            yield "objects_ate_m", float(np.mean([found.off_m for found in by_class.values()]))
            yield "objects_ave_mps", float(np.mean([found.off_mps for found in by_class.values()]))
    yield from ((f"objects_recall.{band}", tally.detected[band] / true) for band, true in tally.impacts.items())
    yield from ((f"tracks_{name}", value) for name, value in tally.tracks.figures.items())


def parts_of(logs: int) -> int:
    """The number of series of frames of each log whose contributions are computed apart."""
    return max(_MOST_PARTS // logs, 1)


def frame_values(run: Run, frame: Numbers, parts: int) -> dict[str, Float]:
    """(F,) what each frame of a run, in rising order, contributes to each figure; the mean is the figure.

    These are the pseudo-values of the jackknife over ``parts`` series of frames: Efron and Tibshirani, An Introduction
    to the Bootstrap, 1993, chapter 11. Equal frames of a part have the same value.

    Raises:
        TableError: a table cannot be read.
    """
    source, numbers = source_of_runs([run]), np.arange(len(frame))
    segments = source.collect(RUN, "frame", pl.col(SEGMENT).alias(SEQUENCE))
    wanted = pl.DataFrame({"frame": frame, AT: numbers})
    scene = read_scene(source, wanted.join(segments, on="frame", how="left", maintain_order="left"))
    if scene is None:
        return {}
    rows = sum(len(of.found.frame) for of in scene.classes.values())
    parts = min(parts, len(frame), max(_FEWEST_PARTS, _MOST_ROWS // max(rows, 1)))
    whole, part = dict(figures(tally_of(scene))), numbers * parts // max(len(frame), 1)
    values = {name: np.full(int(part[-1]) + 1, value) for name, value in whole.items()}
    for number in range(len(next(iter(values.values()), ())) if part[-1] else 0):
        without = dict(figures(tally_of(scene.within(part != number))))
        share = float(np.mean(part == number))
        for name, value in whole.items():
            values[name][number] += (1 - share) / share * (value - without.get(name, value))
    return {name: of[part] + (whole[name] - of[part].mean()) for name, of in values.items()}


def tallies(frames: Frames, groups: Groups) -> list[ObjectTally]:
    """The tally of each group of frames; some logs are read at a time.

    Raises:
        TableError: a table cannot be read.
    """
    found = [ObjectTally() for _ in groups.names]
    order = np.argsort(frames.run, kind="stable")
    ends, keys = np.cumsum(np.bincount(frames.run)), frames.runs.select(frames.source.keys)
    for at in np.split(order, ends[:-1][np.diff(ends // _AT_ONCE) > 0]):
        numbers = {"frame": frames.frame[at], AT: np.arange(len(at)), SEQUENCE: frames.segment[at]}
        scene = read_scene(frames.source, keys[frames.run[at]].hstack(pl.DataFrame(numbers)))
        if scene is not None:
            for group in np.unique(groups.of_frames[at]).tolist():
                found[group] += tally_of(scene.within(groups.of_frames[at] == group))
    return found
