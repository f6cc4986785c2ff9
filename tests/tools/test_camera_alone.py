"""A real video and two networks through the whole chain: lanes, road, pitch and scale with a camera alone.

``make accuracy-long`` uses the whole video, `make test` its first frames.
"""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import roadperc_stream as rp
from roadperc_stream.cli.infer import main as infer
from roadperc_stream.model import Absent

DOCS = Path(__file__).parents[2] / "docs" / "networks"
FEW = 8
HORIZON = 308
"""Row where the lane's boundaries meet, by hand."""
ROWS = range(360, 510, 6)
NEAR = slice(360, 540)


@pytest.fixture(scope="module", params=[FEW, pytest.param(1000, marks=pytest.mark.accuracy)])
def drive(request, data_dir, tmp_path_factory):
    """The frames of the video in colour, and what the chain finds in them."""
    folder = tmp_path_factory.mktemp("camera")
    capture = cv2.VideoCapture(str(data_dir / "highway_video" / "solidWhiteRight.mp4"))
    (folder / "shots").mkdir()
    pictures = []
    while len(pictures) < request.param and (picture := capture.read()[1]) is not None:
        cv2.imwrite(str(folder / "shots" / f"{len(pictures):03}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 95])
        pictures.append(picture)
    networks = []
    for name in ("twinlitenet", "yolox_nano"):
        shutil.copy(DOCS / f"{name}.toml", folder)
        shutil.copy(data_dir / "networks" / f"{name}.onnx", folder)
        networks += ["--network", str(folder / f"{name}.toml")]
    options = ["--fov", "55", "--height", "1.3", "--quiet"]
    assert infer([str(folder / "shots"), str(folder / "in.mcap"), *networks, *options]) == 0
    return pictures, [frame.result for frame in rp.frames(folder / "in.mcap")]


def inner_edge(picture, row):
    """Column of the inner edge of the right, solid marking: halfway between asphalt and paint; None if not clear."""
    first, end = (round(490 + slope * (row - HORIZON)) for slope in (1.3, 2.0))
    levels = picture[row - 1 : row + 2, first:end].min(axis=2).mean(axis=0)
    paint, asphalt = levels.max(), np.percentile(levels, 30)
    at = int(np.argmax(levels > (paint + asphalt) / 2))
    return first + at - 0.5 if paint - asphalt > 40 and at > 0 else None


def column(boundary, row):
    """Column of a boundary's smoothed line."""
    x1, y1, x2, y2 = boundary.smoothed_px
    return x1 + (row - y1) * (x2 - x1) / (y2 - y1)


def test_both_boundaries_are_measured_in_every_frame(drive):
    _, results = drive
    assert {boundary.status for result in results for boundary in result.lanes.boundaries} == {"measured"}


def test_the_right_boundary_is_the_inner_edge_of_the_marking(drive):
    off = [
        column(result.lanes.side("right"), row) - edge
        for picture, result in zip(*drive, strict=True)
        for row in ROWS
        if (edge := inner_edge(picture, row)) is not None
    ]
    assert len(off) > 0.5 * len(drive[0]) * len(ROWS)
    assert np.mean(np.abs(off) < 4) > 0.97


def test_the_road_between_the_boundaries_has_no_holes(drive):
    for result in drive[1][1:]:
        left, right = (result.lanes.side(side) for side in ("left", "right"))
        for row in range(NEAR.start, NEAR.stop):
            inside = slice(max(round(column(left, row)) + 4, 0), max(round(column(right, row)) - 4, 0))
            assert result.drivable[row, inside].all()


def test_pitch_and_scale_are_known_from_the_second_frame_on(drive):
    results = drive[1][1:]
    assert not any(isinstance(result.surface, Absent) or result.surface.source != "estimated" for result in results)
    assert np.degrees([result.surface.pitch for result in results]) == pytest.approx(-2.2, abs=0.4)
    steps = np.array([np.linalg.norm(result.odometry.step[:3, 3]) for result in results])
    assert all(not result.odometry.up_to_scale for result in results)
    means = np.convolve(steps, np.full(min(50, len(steps)), 1 / min(50, len(steps))), "valid")
    assert means == pytest.approx(np.median(steps), rel=0.05)


def test_false_detections_beside_the_road_never_warn(drive):
    assert {item.time_to_impact_s for result in drive[1] for item in result.objects.objects} == {None}
