"""The tables of a report on detections and tracks against the true objects."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from roadperc_stream.output.text_table import Row, Table, rows_of_subjects

from ..report_columns import percent
from .figures import BANDS_S, RINGS_M, Detected, ObjectTally, detected
from .matching import MATCHES_M

_LISTED: Final = 12
"""Most subjects in a row."""
_ABOUT_AP: Final = (
    "AP: nuScenes' average precision, the mean over matches within 0.5, 1, 2 and 4 m on the ground",
    "ATE: error of the place; AVE: of the closing speed; 1 if no error is known, or the recall is below 0.1",
    "nuScenes' ASE, AOE and AAE do not exist: the chain gives no size, no orientation, no attribute",
)
_ABOUT_TRACKS: Final = ("similarity 1 - d / 4 m on the ground; MOTA, IDF1 and IDSW: matches within 2 m",)
_ABOUT_RECALL: Final = (
    "true objects in the path by true time to impact; found: a kept detection of the frame matches",
)


def object_tables(tallies: Mapping[str, ObjectTally]) -> Iterator[Table]:
    """The tables with rows, of the tallies of each subject by its name."""
    shown, several = dict(list(tallies.items())[:_LISTED]), len(tallies) > 1
    names = sorted({name for tally in shown.values() for name in tally.classes})
    found = {
        f"{name} {ring}".rstrip(): {
            subject: _detection(of) for subject, tally in shown.items() if (of := detected(tally, name, ring))
        }
        for name in names
        for ring in RINGS_M
    }
    headers = ("true", "AP", *(f"{limit_m:g} m" for limit_m in MATCHES_M), "ATE m", "AVE m/s")
    yield from _table("Detection", headers, found, several, _ABOUT_AP)
    tracks = {subject: _tracks(tally) for subject, tally in shown.items() if tally.tracks.true}
    headers = ("HOTA", "DetA", "AssA", "MOTA", "IDF1", "IDSW")
    yield from _table("Tracks", headers, {"all classes": tracks} if tracks else {}, several, _ABOUT_TRACKS)
    impacts = {
        band: {
            subject: (str(true), percent(tally.detected[band] / true))
            for subject, tally in shown.items()
            if (true := tally.impacts[band])
        }
        for band in BANDS_S
    }
    yield from _table("Time to impact", ("true", "found %"), impacts, several, _ABOUT_RECALL)


def _table(
    title: str, headers: Sequence[str], rows: Mapping[str, Mapping[str, Row]], several: bool, notes: Sequence[str]
) -> Iterator[Table]:
    filled = {label: cells for label, cells in rows.items() if cells}
    if filled:
        yield Table(title, tuple(headers), rows_of_subjects(filled, several), tuple(notes), label_columns=20)


def _detection(found: Detected) -> Row:
    precision = (f"{value:.3f}" for value in (found.mean, *found.precision))
    return str(found.true), *precision, f"{found.off_m:.3f}", f"{found.off_mps:.2f}"


def _tracks(tally: ObjectTally) -> Row:
    return *(f"{value:.3f}" for value in tally.tracks.figures.values()), str(tally.tracks.switched)
