"""The strip at the top of an overlay shows the frame's row and covers only its lines."""

from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream.model import Absent, Lanes, Object, Objects, Reason
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.canvas import Canvas
from roadperc_stream.output.drawing.colours import bgr
from roadperc_stream.output.drawing.overlay import (
    LEGEND,
    PerceivedFrame,
    draw_frame,
    draw_strip,
    frame_phrases,
    legend_of,
    lines_of,
)
from roadperc_stream.schemas.columns import FrameMetrics
from tests.analytic import box

ROW = FrameMetrics("log", 7, 0)
FULL = FrameMetrics(
    "log",
    7,
    0,
    surface_source="stereo",
    lane_left_status="measured",
    lane_left_offset_m=1.525,
    lane_right_status="held",
    lane_right_offset_m=-1.861,
    odometry_status="tracked",
    step_m=0.5,
)


CAR = Object(box("Car", 0, 0, 9, 9), kept=True, distance_m=3.26, time_to_impact_s=0.51)
FAR_CAR = replace(CAR, distance_m=15.77, time_to_impact_s=0.2)
NOTHING = Absent(Reason("objects", "not_run"))


def words(row, *objects, since_start_s=0.35):
    return [phrase.text for phrase in frame_phrases(row, Objects(objects), since_start_s)]


def test_the_strip_shows_the_numbers_of_the_row():
    assert words(FULL, CAR) == [
        "frame 7",
        "0.35 s",
        "lane left +1.52 m",
        "lane right -1.86 m",
        "nearest Car 3.3 m, impact in 0.5 s",
        "step 0.50 m",
        "surface: stereo",
    ]


def test_null_values_are_left_out():
    assert words(ROW) == ["frame 7", "0.35 s"]
    assert [phrase.text for phrase in frame_phrases(ROW, NOTHING, 0.35)] == ["frame 7", "0.35 s"]


@pytest.mark.parametrize(
    ("objects", "text"),
    [
        ([CAR, FAR_CAR], ["impact: Car 15.8 m in 0.2 s", "nearest Car 3.3 m"]),
        ([FAR_CAR, replace(CAR, time_to_impact_s=None)], ["impact: Car 15.8 m in 0.2 s", "nearest Car 3.3 m"]),
        ([CAR, replace(FAR_CAR, kept=False)], ["nearest Car 3.3 m, impact in 0.5 s"]),
        ([replace(CAR, time_to_impact_s=None)], ["nearest Car 3.3 m"]),
        ([replace(CAR, distance_m=None)], ["impact: Car in 0.5 s"]),
        ([replace(CAR, detection=box("", 0, 0, 9, 9), time_to_impact_s=None)], ["nearest object 3.3 m"]),
        ([replace(CAR, kept=False)], []),
    ],
)
def test_a_time_to_impact_is_next_to_its_object(objects, text):
    assert words(ROW, *objects)[2:] == text


@pytest.mark.parametrize(
    ("columns", "text"),
    [
        ({"odometry_status": "lost"}, "odometry lost"),
        ({"odometry_status": "first"}, "odometry first"),
        ({"odometry_status": "tracked"}, "odometry without scale"),
        ({"lane_left_status": "lost"}, "lane left lost"),
    ],
)
def test_a_status_replaces_a_missing_number(columns, text):
    assert words(FrameMetrics("log", 7, 0, **columns))[-1] == text


def test_absent_results_have_a_reason_and_no_legend():
    """The picture of a log with images alone says why nothing is drawn."""
    row = replace(ROW, reasons=(Reason("lanes", "no_segmentation"), Reason("objects", "no_detections")))
    assert [phrase.text for phrase in frame_phrases(row, NOTHING, 0.35)][2:] == [
        "lanes: no segmentation",
        "objects: no detections",
    ]
    image, absent = np.zeros((9, 9, 3), np.uint8), Absent(Reason("lanes", "no_segmentation"))
    assert not list(legend_of(PerceivedFrame(image, absent, NOTHING, absent)))
    drivable = PerceivedFrame(image, absent, NOTHING, np.zeros((9, 9), np.bool_))
    assert [entry.text for entry in legend_of(drivable)] == ["drivable"]
    assert tuple(legend_of(PerceivedFrame(image, Lanes(()), Objects(()), np.zeros((9, 9), np.bool_)))) == LEGEND


def test_the_legend_has_every_colour_of_an_overlay():
    drawn = [*colours.OBJECT.values(), colours.RAW_LINE, colours.DRIVABLE]
    drawn += [colours.BOUNDARY[status] for status in ("measured", "held")]
    assert {bgr(colour) for colour in drawn} == {entry.colour for entry in LEGEND}
    assert {entry.text: entry.colour for entry in LEGEND}["unverified"] == bgr(colours.OBJECT["unverified"])


@pytest.mark.parametrize(("rows", "columns"), [(270, 360), (960, 1280)])
def test_the_strip_covers_the_top_rows_and_cuts_no_text(rows, columns):
    canvas = Canvas(np.full((rows, columns, 3), 200, np.uint8))
    strip = lines_of((*frame_phrases(FULL, Objects((CAR, FAR_CAR)), 0.35), *LEGEND), canvas)
    draw_strip(canvas, strip)
    pixels = canvas.pixels
    touched = (pixels != 200).any(axis=(1, 2))
    covered = int(touched.sum())
    assert touched[:covered].all()
    assert covered == len(strip) * canvas.row_px
    assert 20 < covered < rows / 4
    shade = pixels[0, 0]
    assert (shade < 100).all()
    np.testing.assert_array_equal(pixels[:covered, -1], np.broadcast_to(shade, (covered, 3)))


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (20, 30)])
def test_the_strip_fits_into_tiny_images(rows, columns):
    canvas = Canvas(np.zeros((rows, columns, 3), np.uint8))
    draw_strip(canvas, lines_of((*frame_phrases(FULL, Objects((CAR, FAR_CAR)), 0.0), *LEGEND), canvas))


def test_a_small_image_has_no_legend_which_would_cover_the_road():
    """The numbers are always there."""
    shaded = {}
    for rows, columns in ((270, 360), (960, 1280)):
        results = Lanes(()), Objects(()), np.zeros((rows, columns), np.bool_)
        frame = PerceivedFrame(np.full((rows, columns, 3), 255, np.uint8), *results)
        drawn = draw_frame(frame, FULL, 0.35, columns)
        shaded[rows] = int((drawn.min(axis=(1, 2)) < 255).sum()) / rows
    assert 0 < shaded[270] <= 0.15
    assert 0 < shaded[960] <= 0.15
