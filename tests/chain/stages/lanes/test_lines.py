"""Image lines: merging by hand, edges that face the ego lane, and the public figures of the course's frames."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.stages.lanes import lines
from roadperc_stream.chain.stages.lanes.observe import facing_edges
from roadperc_stream.config import LanesConfig, load_config
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE

CFG = LanesConfig()
PUBLIC = ("median_px=0", "hough_rho_px=10", "hough_threshold=200", "hough_min_length_px=150", "hough_max_gap_px=50")


def line(slope, intercept, y1=960.0, y2=500.0):
    return [(y1 - intercept) / slope, y1, (y2 - intercept) / slope, y2]


def test_merge_joins_lines_with_similar_slope_and_intercept():
    proposals = np.array([line(-1.0, 1000), line(-1.05, 1020), line(-1.2, 1000), line(-1.0, 1060), line(0.5, 100)])
    groups = lines.merge(proposals, 960)
    assert [(round(g.slope, 3), round(g.intercept, 3)) for g in groups] == [
        (-1.025, 1010.0),
        (-1.2, 1000.0),
        (-1.0, 1060.0),
        (0.5, 100.0),
    ]


@pytest.mark.parametrize(
    ("proposals", "rows", "groups"),
    [
        pytest.param([line(-1.0, 1000), line(-1.09, 1000), line(-1.18, 1000)], 960, 2, id="far from the first line"),
        pytest.param([line(-1.0, 500, 480, 250), line(-1.0, 530, 480, 250)], 960, 1, id="30 of 960 rows apart"),
        pytest.param([line(-1.0, 500, 480, 250), line(-1.0, 530, 480, 250)], 480, 2, id="30 of 480 rows apart"),
    ],
)
def test_lines_near_the_first_line_of_a_group_are_merged(proposals, rows, groups):
    assert len(lines.merge(np.array(proposals), rows)) == groups


def test_a_group_remembers_the_rows_that_support_it():
    (group,) = lines.merge(np.array([line(-1.0, 1000, 900, 700), line(-1.0, 1001, 650, 600)]), 960)
    assert (group.top_px, group.bottom_px) == (600, 900)
    assert lines.drawn(group, 960.0, 500.0) == pytest.approx((40.5, 960.0, 500.5, 500.0))


def test_near_horizontal_lines_and_lines_off_the_road_are_dropped():
    road = np.zeros((960, 1280), bool)
    road[500:, 300:900] = True
    proposals = np.array(
        [[400.0, 900, 800, 800], [400.0, 900, 500, 600], [950.0, 900, 1000, 600], [298.0, 900, 298, 600]]
    )
    kept = lines.on_road(proposals, road)
    np.testing.assert_array_equal(kept, proposals[[1, 3]])


@pytest.mark.parametrize("size", [(60, 80), (960, 1280)])
def test_lines_are_on_the_road_if_most_of_their_pixels_are(size):
    """Decided on some pixels of each line, for roads of random stripes; lines on and off by halves are left out."""
    rng, (height, width) = np.random.default_rng(0), size
    road = np.repeat(rng.random(20) < 0.5, height // 20)[:, None] & np.ones(width, bool)
    ends = rng.integers(0, (width, height, width, height), (200, 4)).astype(float)
    margin = max(round(height / 960 * lines._ROAD_MARGIN_PX), 1)
    widened = cv2.dilate(road.view(np.uint8), np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
    kept = {tuple(line) for line in lines.on_road(ends, road).tolist()}
    decided = 0
    for x1, y1, x2, y2 in ends.tolist():
        count = int(max(abs(x2 - x1), abs(y2 - y1))) + 1
        rows, columns = (np.rint(np.linspace(*ends, count)).astype(int) for ends in ((y1, y2), (x1, x2)))
        share = widened[rows, columns].mean()
        if abs(y2 - y1) >= lines._MIN_SLOPE * abs(x2 - x1) and abs(share - 0.5) > 0.1:
            decided += 1
            assert ((x1, y1, x2, y2) in kept) == (share > 0.5)
    assert decided > 50


def test_a_vertical_line_is_a_line_and_a_single_pixel_is_not():
    proposals = np.array([[500.0, 700, 500, 700], [500.0, 900, 500, 600]])
    kept = lines.on_road(proposals, np.ones((960, 1280), bool))
    np.testing.assert_array_equal(kept, proposals[[1]])
    (group,) = lines.merge(kept, 960)
    assert group.x(960.0) == pytest.approx(500.0, abs=1e-3)


def test_far_end_ignores_a_speck():
    road = np.zeros((100, 200), bool)
    road[40:, 50:150] = True
    road[5, 7] = True
    assert lines.road_rows(road) == (40, 100)
    assert lines.road_rows(np.zeros((100, 200), bool)) is None


def test_public_figures_of_course_frame_0(data_dir):
    """9 proposals and 5 merged lines, with the settings printed there."""
    tags = np.loadtxt(data_dir / "course_frames" / "segmentation" / "0.dat", delimiter=",").astype(np.uint8)
    cfg = load_config(None, tuple(f"lanes.{setting}" for setting in PUBLIC)).lanes
    proposals = lines.propose(cfg, lines.edges_of(cfg, TABLE.lookup(cfg.separators)[tags]))
    assert len(proposals) == 9
    road = TABLE.lookup(["road", "road_line"])[tags].view(bool)
    assert len(lines.merge(lines.on_road(proposals, road), 960)) == 5


@pytest.mark.parametrize(("gap_px", "found"), [(60, True), (80, False)])
def test_dashes_are_one_line_where_their_gaps_are_short(gap_px, found):
    """Dashes of 60 px along a diagonal are too short for a line; over gaps of up to 50 columns they form one."""
    edges = np.zeros((960, 1280), np.uint8)
    along = np.arange(600)
    drawn = along[along % (60 + gap_px) < 60] / np.sqrt(2)
    edges[(900 - drawn).astype(int), (300 + drawn).astype(int)] = 255
    proposals = lines.propose(CFG.model_copy(update={"hough_threshold": 100}), edges)
    lengths = np.hypot(proposals[:, 2] - proposals[:, 0], proposals[:, 3] - proposals[:, 1])
    assert bool((lengths > 400).any()) == found


@pytest.mark.parametrize(("rows", "median_px"), [(960, 0), (960, 3), (960, 5), (480, 5), (96, 99), (1440, 21)])
def test_counting_gives_the_median_filter(rows, median_px):
    mask = (np.random.default_rng(median_px).random((rows, 64)) < 0.5).astype(np.uint8)
    cfg = CFG.model_copy(update={"median_px": median_px})
    size = round(median_px * rows / 960)
    expected = cv2.medianBlur(mask * np.uint8(255), size | 1) if size >= 2 else mask * np.uint8(255)
    np.testing.assert_array_equal(lines.without_salt(cfg, mask), expected)


@pytest.mark.parametrize("aperture", [3, 5, 7])
@pytest.mark.parametrize("top", [0, 3, 40, 95])
def test_edges_are_those_of_the_whole_image(aperture, top):
    """Edges are searched only in rows with separators."""
    mask = np.zeros((96, 128), np.uint8)
    mask[top : top + 30] = np.random.default_rng(top).random((96 - top, 128))[:30] < 0.6
    cfg = CFG.model_copy(update={"median_px": 0, "canny_aperture": aperture, "canny_low": 500.0, "canny_high": 1500.0})
    whole = cv2.Canny(mask * np.uint8(255), cfg.canny_low, cfg.canny_high, apertureSize=aperture)
    np.testing.assert_array_equal(lines.edges_of(cfg, mask), whole)
    assert not lines.edges_of(cfg, np.zeros_like(mask)).any()


def test_lines_have_their_places_at_both_pixel_steps():
    """A stripe of 9 px in the whole image, and as seen in every second pixel."""
    stripe = np.zeros((960, 1280), np.uint8)
    cv2.line(stripe, (300, 950), (600, 500), 1, 9)
    for median_px, step in ((0, 1), (5, 2)):
        cfg = CFG.model_copy(update={"median_px": median_px})
        assert lines.pixel_step(cfg, 960) == step
        edges = lines.edges_of(cfg, np.ascontiguousarray(stripe[::step, ::step]))
        (*_, group) = lines.merge(lines.propose(cfg, edges, step=step) * step, 960)
        assert group.slope == pytest.approx(-1.5, abs=0.05)
        assert group.x(725.0) == pytest.approx(450.0, abs=3.0)


def test_facing_edges_look_towards_the_ego_lane():
    separators = np.zeros((4, 20), np.uint8)
    separators[:, 4:7] = separators[:, 15:] = 1
    road = np.ones((6, 20), bool)
    left, right = facing_edges(separators, road, 2).values()
    np.testing.assert_array_equal(left, [[6.5, row] for row in (2, 3, 4, 5)])
    assert set(right[:, 0]) == {3.5, 14.5}
    assert len(facing_edges(separators, ~road, 2)["left"]) == 0


def test_edges_of_every_second_row_are_those_of_these_rows():
    rng = np.random.default_rng(0)
    separators, road = (rng.random((7, 30)) < 0.3).astype(np.uint8), rng.random((9, 30)) < 0.5
    whole, every_second = facing_edges(separators, road, 2), facing_edges(separators[::2].copy(), road, 2, 2)
    for side, edges in whole.items():
        np.testing.assert_array_equal(every_second[side], edges[edges[:, 1] % 2 == 0])


@pytest.mark.parametrize(("fringe_px", "found"), [(0, True), (1, True), (4, True), (5, False)])
def test_edges_face_each_other_across_a_fringe_of_foreign_pixels(fringe_px, found):
    separators = np.zeros((4, 40), np.uint8)
    separators[:, 10:14] = 1
    road = np.ones((4, 40), bool)
    road[:, 10 - fringe_px : 14 + fringe_px] = False
    for side, middle in (("left", 13.5 + fringe_px / 2), ("right", 9.5 - fringe_px / 2)):
        edges = facing_edges(separators, road, 0)[side]
        assert set(edges[:, 0]) == ({middle} if found else set())


@given(st.integers(0, 2**32 - 1))
def test_a_mirrored_image_has_the_mirrored_edges_in_the_same_order(seed):
    rng = np.random.default_rng(seed)
    separators = (rng.random((6, 30)) < 0.3).astype(np.uint8)
    road = rng.random((8, 30)) < 0.5
    left = facing_edges(separators, road, 2)["left"]
    mirrored = facing_edges(separators[:, ::-1], road[:, ::-1], 2)["right"]
    np.testing.assert_array_equal(mirrored, left * (-1, 1) + (29, 0))
    assert (np.diff(left[:, 1]) >= 0).all()
