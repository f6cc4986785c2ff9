"""Depth of pairs with known disparities: shifted textures, the course's pair, rendered scenes."""

import json
import re
from dataclasses import astuple, replace
from statistics import fmean
from time import process_time

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages import stereo
from roadperc_stream.chain.stages.objects.template import correlate
from roadperc_stream.chain.stages.stereo import disparities_needed
from roadperc_stream.cli import render
from roadperc_stream.config import StereoConfig, load_config
from roadperc_stream.geometry.rectification import lens_fault
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input.decoding import camera_from_calibration
from roadperc_stream.metrics.stereo import stereo_errors
from roadperc_stream.model import Absent, Box
from roadperc_stream.output.encoding import encode_calibration
from tests import pair
from tests.course import SETTINGS

HEIGHT, WIDTH = 120, 240
LEFT = g.Camera("left", WIDTH, HEIGHT, 200.0, 200.0, 119.5, 59.5)
RIGHT = replace(LEFT, frame_id="right", baseline_m=0.5)
MOUNTING = g.mounting(z=1.4)
FULL, FAST = StereoConfig(method="full"), StereoConfig(method="fast")
BOTH = pytest.mark.parametrize("cfg", [FULL, FAST], ids=["full", "fast"])
RENDERED = g.Camera("left", 1280, 960, 640.0, 640.0, 639.5, 479.5)


def texture(seed=0, width=WIDTH + 64):
    """A texture smooth enough for shifts by fractions of a pixel."""
    noise = np.random.default_rng(seed).uniform(0, 255, (HEIGHT, width)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)


def view(picture, disparity_px):
    """The picture's columns from 32 on, shifted left by a disparity."""
    columns = np.tile(np.arange(WIDTH, dtype=np.float32) + 32 + disparity_px, (HEIGHT, 1))
    rows = np.tile(np.arange(HEIGHT, dtype=np.float32)[:, None], (1, WIDTH))
    return cv2.remap(picture, columns, rows, cv2.INTER_LINEAR).astype(np.uint8)


def matched(cfg, left, right, left_camera=LEFT, right_camera=RIGHT):
    found = stereo.match(cfg, left_camera, right_camera, MOUNTING, left, right)
    assert not isinstance(found, Absent), found
    assert (found.depth_m.dtype, found.depth_m.shape, found.frame_id) == (np.float32, left.shape[:2], "left")
    return found.depth_m


@pytest.mark.parametrize("shift_px", [8.0, 19.7, 28.5])
@pytest.mark.parametrize(("cfg", "exact_px"), [(FULL, 0.1), (FAST, 0.2)], ids=["full", "fast"])
def test_a_shifted_texture_has_one_depth(cfg, exact_px, shift_px):
    depth = matched(cfg, view(texture(), 0.0), view(texture(), shift_px))
    inner = depth[10:-10, 40:-10]
    assert np.median(np.abs(100.0 / inner - shift_px)) < exact_px
    assert np.isfinite(inner).mean() > 0.99


def test_cameras_may_differ_in_brightness():
    left, right = view(texture(), 0.0), view(texture(), 10.25)
    dimmer = np.clip(right.astype(int) - 6, 0, 255).astype(np.uint8)
    inner = matched(FULL, left, dimmer)[10:-10, 40:-10]
    assert np.nanmedian(np.abs(100.0 / inner - 10.25)) < 0.1


@BOTH
def test_pixels_hidden_from_the_right_camera_are_unknown(cfg):
    """A near square hides as many columns as its disparity exceeds the ground's."""
    ground, near = texture(1), texture(2)
    left, right = view(ground, 0.0), view(ground, 8.0)
    square = view(near, 0.0)[40:80, 100:140]
    left[40:80, 100:140], right[40:80, 76:116] = square, square
    disparity = 100.0 / matched(cfg, left, right)
    assert np.nanmedian(disparity[45:75, 105:135]) == pytest.approx(24, abs=0.3)
    assert np.nanmedian(disparity[45:75, 50:78]) == pytest.approx(8, abs=0.3)
    assert np.isnan(disparity[45:75, 86:98]).mean() > 0.8
    assert np.isnan(disparity[:, :8]).mean() > 0.9
    grey = np.full((HEIGHT, WIDTH), 90, np.uint8)
    assert np.isnan(matched(cfg, grey, grey)).all()


def test_disparities_below_the_minimum_are_unknown():
    pair = view(texture(), 0.0), view(texture(), 3.0)
    assert np.isfinite(matched(FULL, *pair)).mean() > 0.9
    assert np.isfinite(matched(StereoConfig(method="full", min_disparity_px=4.0), *pair)).mean() < 0.01


@BOTH
def test_images_of_odd_size(cfg):
    left, right = (image[:-1, :-1] for image in (view(texture(), 0.0), view(texture(), 10.0)))
    camera = replace(LEFT, width=WIDTH - 1, height=HEIGHT - 1)
    depth = matched(cfg, left, right, camera, replace(camera, baseline_m=0.5))
    assert np.nanmedian(depth) == pytest.approx(10.0, rel=0.03)


def test_threads_do_not_change_the_depth():
    before, pair = cv2.getNumThreads(), (view(texture(), 0.0), view(texture(), 10.25))
    found = []
    for threads in (1, 2):
        cv2.setNumThreads(threads)
        found.append(matched(FAST, *pair))
    cv2.setNumThreads(before)
    np.testing.assert_array_equal(*found)


def test_disparities_reach_the_nearest_road():
    """The bottom row sees the road at 1.4 * 640 / 479.5 m: 640 * 0.5 / 1.8686 = 171.3, and a tenth more."""
    assert disparities_needed(RENDERED, 0.5, g.mounting(z=1.4)) == 192
    assert disparities_needed(RENDERED, 0.5, g.mounting(z=2.8)) == 96
    assert disparities_needed(RENDERED, 0.25, g.mounting(z=1.4)) == 96
    assert disparities_needed(RENDERED, 50.0, g.mounting(z=1.4)) == 1280
    assert disparities_needed(RENDERED, 0.5, g.mounting(z=0.0)) is None
    down = g.rigid(rotation_from_rpy(0, 0.2, 0) @ g.EGO_R_OPTICAL, np.array([0, 0, 1.4]))
    assert disparities_needed(RENDERED, 0.5, down) > 192


def with_lens(distortion=(), **changes):
    """The left camera with an unrectified image and a changed lens."""
    lens = g.Lens(LEFT.fx, LEFT.fy, LEFT.cx, LEFT.cy)
    return replace(LEFT, lens=replace(lens, **changes), distortion=distortion)


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
def test_every_lens_of_opencv_is_rectified(count):
    assert lens_fault(with_lens((1e-3,) * count)) is None
    matched(FAST, *[view(texture(), 0.0)] * 2, with_lens((1e-3,) * count))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"left_image": None}, "no left image"),
        ({"right_image": None}, "no right image"),
        ({"left_image": None, "right_image": None}, "no left image, no right image"),
        ({"right": replace(RIGHT, baseline_m=None)}, r"P\[0\]\[3\] of the right camera is 0"),
        *(
            (
                {"right": replace(RIGHT, baseline_m=bad)},
                rf"a baseline of {re.escape(f'{bad:g}')} m: expected -fx \* baseline, which is 0.001 to 1000 m",
            )
            for bad in (-0.5, 1e30, np.inf, 1e-30)
        ),
        ({"right": replace(RIGHT, width=100)}, "left camera has 240x120 pixels, the right one 100x120"),
        ({"right_image": np.zeros((60, 60), np.uint8)}, "right image: 60x60 pixels, its calibration says 240x120"),
        ({"left": replace(LEFT, distortion=(0.1, 0.0, 0.0, 0.0))}, "the left camera has distortion but no R"),
        ({"right": replace(RIGHT, lens=g.Lens(200, 200, 119, 59, (1.0,) * 9))}, "R that is not a rotation"),
        ({"right": replace(RIGHT, lens=g.Lens(200, 200, 119, 59, model="division"))}, "model 'division'"),
        ({"left": replace(with_lens((0.1,) * 5, model="equidistant"))}, "5 distortion coefficients, expected one of 4"),
        ({"ego_T_left": g.mounting(z=-1.0)}, "set stereo.disparities"),
        *(
            ({"left": with_lens(R=(bad,) * 9)}, f"the left camera has an R that is not a rotation: .*{bad:.3}")
            for bad in (np.nan, np.inf, 1e-300)
        ),
        *(
            ({"right": replace(with_lens(distortion=(0.1,) * n), baseline_m=0.5)}, f"right camera has {n} distortion")
            for n in (1, 3, 20)
        ),
        ({"left": with_lens(distortion=(0.1,) * 6)}, "6 distortion coefficients, expected one of 4, 5, 8, 12, 14"),
        *(
            ({"left": with_lens(distortion=(0.0, bad, 0.0, 0.0))}, f"distortion coefficient {bad:g}, expected at most")
            for bad in (np.nan, np.inf, -20000.0)
        ),
        *(
            ({"left": with_lens(**{name: bad})}, f"an invalid K: {name} {bad:g}: expected")
            for name, values in {
                "fx": (np.nan, 300000.0, 1e-30),
                "fy": (0.0, -100.0, np.inf),
                "cx": (np.nan, 2401.0),
                "cy": (-np.inf, -1e5),
            }.items()
            for bad in values
        ),
    ],
)
def test_missing_depth_has_a_reason(changes, reason):
    image = view(texture(), 0.0)
    asked = {"cfg": FAST, "left": LEFT, "right": RIGHT, "ego_T_left": MOUNTING}
    found = stereo.match(**{**asked, "left_image": image, "right_image": image, **changes})
    assert isinstance(found, Absent)
    assert re.search(reason, found.reason.text), found.reason


def pixel_rays(camera):
    return g.rays(camera, np.moveaxis(np.indices(camera.size, dtype=float)[::-1], 0, -1))


def lens_view(camera, picture):
    """The rectified picture seen through the camera's lens."""
    lens = camera.lens
    rows, columns = np.indices(camera.size, dtype=float)
    pixels = np.stack((columns, rows), axis=-1).reshape(-1, 1, 2)
    R = np.array(lens.R).reshape(3, 3)
    there = cv2.undistortPoints(pixels, lens.K, np.array(camera.distortion), R=R, P=camera.K).reshape(*camera.size, 2)
    columns, rows = np.moveaxis(there.astype(np.float32), -1, 0)
    return cv2.remap(picture, columns, rows, cv2.INTER_LINEAR)


def turned(roll, pitch, yaw):
    return tuple(rotation_from_rpy(roll, pitch, yaw).ravel())


def test_an_unrectified_pair_is_rectified_first():
    left = replace(LEFT, distortion=(-0.1, 0.02, 0.001, 0.0), lens=g.Lens(210, 205, 118, 61, turned(0.01, 0.02, -0.02)))
    right = replace(RIGHT, distortion=(-0.08, 0.0, 0.0, 0.001), lens=g.Lens(195, 198, 121, 58, turned(-0.02, 0, 0.01)))
    pair = lens_view(left, view(texture(), 0.0)), lens_view(right, view(texture(), 20.0))
    # All points are 5 m ahead of the rectified camera, to which the left one is rotated.
    true_m = 5.0 / (pixel_rays(LEFT) @ np.array(left.lens.R).reshape(3, 3)[2])
    plain, depth = (matched(FULL, *pair, *cameras) - true_m for cameras in ((LEFT, RIGHT), (left, right)))
    inner = np.s_[20:-20, 50:-20]
    assert np.isfinite(depth[inner]).mean() > 0.95
    assert np.nanmedian(np.abs(depth[inner])) < 0.05
    assert not np.nanmedian(np.abs(plain[inner])) < 0.05
    for camera in (left, right):
        assert camera_from_calibration(CameraCalibration.FromString(encode_calibration(1, camera))) == camera


@pytest.mark.parametrize(("cfg", "p95"), [(FULL, 0.02), (FAST, 0.04)], ids=["full", "fast"])
def test_the_depth_belongs_to_the_mounted_left_camera(cfg, p95):
    """For road and car nearer than 25 m; in the rectified camera, turned by 2 degrees, the median error is 9 %."""
    pinhole = replace(RENDERED, width=640, height=480, fx=320.0, fy=320.0, cx=319.5, cy=239.5)
    (left, ego_T_left), (right, ego_T_right) = pair.crooked(pinhole, 0.5, g.mounting(z=1.2), 2.0)
    images = pair.photograph(left, ego_T_left), pair.photograph(right, ego_T_right)
    true_m = pair.depth_of(left, ego_T_left)
    error = np.abs(stereo.match(cfg, left, right, ego_T_left, *images).depth_m / true_m - 1)[true_m < 25]
    assert np.isfinite(error).mean() > 0.88
    assert (np.nanmedian(error) < 0.005, np.nanquantile(error, 0.95) < p95) == (True, True)


def test_the_number_of_disparities_is_that_of_the_rectified_camera(monkeypatch):
    """A camera mounted 20 degrees nose up, rectified to a level one, which needs more disparities."""
    counts, image = [], view(texture(), 0.0)

    def count_only(_cfg, count, grey, _right):
        counts.append(count)
        return np.ones(grey.shape, np.float32)

    monkeypatch.setattr(stereo, "disparity", count_only)
    up = rotation_from_rpy(0.35, 0.0, 0.0)
    left = replace(LEFT, lens=g.Lens(200, 200, 119.5, 59.5, tuple(up.ravel())))
    for camera, ego_T_left in ((LEFT, MOUNTING), (left, MOUNTING @ g.rigid(up, np.zeros(3)))):
        stereo.match(FULL, camera, RIGHT, ego_T_left, image, image)
    assert counts[0] == counts[1] == disparities_needed(LEFT, RIGHT.baseline_m, MOUNTING)


def test_pixels_outside_an_image_before_rectification_are_unknown():
    right = replace(RIGHT, lens=g.Lens(200, 200, 119.5 - 60, 59.5))
    left = replace(LEFT, lens=g.Lens(200, 200, 119.5, 59.5 - 30))
    picture = view(texture(), 0.0), view(texture(), 20.0)
    depth = matched(FULL, lens_view(left, picture[0]), lens_view(right, picture[1]), left, right)
    assert np.isnan(depth[:29]).all()
    assert np.isnan(depth[:, :79]).mean() > 0.95
    assert np.nanmedian(depth) == pytest.approx(5.0, rel=0.01)
    assert np.isfinite(depth[40:-10, 90:-10]).mean() > 0.95


def test_a_right_camera_with_other_intrinsics_is_resampled_to_the_left_one():
    right = replace(RIGHT, fx=190.0, fy=205.0, cx=130.0, cy=55.0)
    lens = replace(LEFT, lens=g.Lens(right.fx, right.fy, right.cx, right.cy))
    depth = matched(FULL, view(texture(), 0.0), lens_view(lens, view(texture(), 20.0)), LEFT, right)
    assert np.nanmedian(np.abs(depth[20:-20, 60:-20] - 5.0)) < 0.05


@pytest.fixture(scope="module")
def course(data_dir):
    folder = data_dir / "course_stereo"
    calibration, expected = (json.loads((folder / f"{name}.json").read_text()) for name in ("calibration", "expected"))
    return calibration, expected, *(cv2.imread(str(folder / f"{side}.png")) for side in ("left", "right"))


def test_the_courses_matrices(course):
    calibration, expected, *_ = course
    P_left, P_right = (np.array(calibration[name]) for name in ("P_left", "P_right"))
    for P, centre in ((P_left, expected["centre_left"]), (P_right, expected["centre_right"])):
        K, R, found = g.decompose_projection(P)
        np.testing.assert_allclose(K, expected["K"], atol=1e-9)
        np.testing.assert_allclose(R, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(found, centre, atol=1e-12)
    assert g.baseline_of(P_left, P_right) == pytest.approx(expected["baseline_m"], abs=1e-12)


def test_the_courses_nearest_depth_with_its_public_settings(course):
    calibration, expected, *pair = course
    public = expected["sgbm"]
    cfg = load_config(None, SETTINGS).stereo
    assert (cfg.disparities, cfg.block_px, cfg.p1, cfg.p2) == tuple(
        public[name] for name in ("numDisparities", "blockSize", "P1", "P2")
    )
    left, right = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in pair)
    disparity = stereo.disparity(cfg, cfg.disparities, left, right).astype(float)
    disparity[np.isnan(disparity)] = public["replace_disparity_0_and_minus1_by"]
    depth = 640.0 * 0.5 / disparity
    x0, y0, x1, y1 = calibration["obstacle_template_px"]
    box, score = correlate(left, left[y0:y1, x0:x1], Box(0, 0, 1280, 960)).match(0.9)
    assert [box.x_min, box.y_min] == expected["template_top_left_px"] == [547, 479]
    assert score == pytest.approx(1.0)
    assert depth[y0:y1, x0:x1].min() == pytest.approx(expected["nearest_depth_m"], abs=1e-9)


@BOTH
def test_the_courses_nearest_depth_with_the_defaults(course, cfg):
    calibration, expected, *pair = course
    left, right = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in pair)
    camera = g.Camera("left", 1280, 960, 640.0, 480.0, 639.5, 479.5)
    depth = matched(cfg, left, right, camera, replace(camera, baseline_m=0.5))
    x0, y0, x1, y1 = Box(*calibration["obstacle_template_px"]).rounded(1280, 960)
    nearest = float(np.nanquantile(depth[y0:y1, x0:x1], 0.02))
    print(f"\ncourse_stereo, {cfg.method}: {nearest:.3f} m, {nearest / expected['nearest_depth_m'] - 1:+.2%}")
    assert nearest == pytest.approx(expected["nearest_depth_m"], rel=0.05)


def rendered(folder, *options):
    """Camera, baseline, mounting and (left, right, true depth) of a rendered scene's frames."""
    assert render.main([str(folder), *options]) == 0
    calibration = json.loads((folder / "calibration.json").read_text())
    K = np.array(calibration["K"])
    size = calibration["width"], calibration["height"]
    camera = g.Camera("left", *size, K[0, 0], K[1, 1], K[0, 2] - 0.5, K[1, 2] - 0.5)
    frames = []
    for path in sorted((folder / "rgb").iterdir()):
        left, right = (cv2.imread(str(folder / n / path.name), cv2.IMREAD_GRAYSCALE) for n in ("rgb", "right"))
        code = cv2.imread(str(folder / "depth" / path.name))
        metres = code.astype(float) @ [65536, 256, 1] * (1000 / (2**24 - 1))
        frames.append((left, right, metres.astype(np.float32)))
    return camera, calibration["baseline_m"], g.mounting(z=calibration["mounting"]["rgb"]["z"]), frames


def figures(cfg, camera, baseline_m, mounting, frames):
    """Means over the frames of end-point error, D1 and coverage; prints the CPU time."""
    errors, seconds = [], 0.0
    for left, right, true_m in frames:
        started = process_time()
        found = stereo.match(cfg, camera, replace(camera, baseline_m=baseline_m), mounting, left, right)
        seconds += process_time() - started
        errors.append(stereo_errors(found.depth_m, true_m, camera, baseline_m))
    epe_px, d1_ratio, _, coverage = (fmean(values) for values in zip(*map(astuple, errors), strict=True))
    print(
        f"\n{cfg.method}: EPE {epe_px:.3f} px, D1 {d1_ratio:.2%}, coverage {coverage:.1%}, "
        f"{1000 * seconds / len(frames):.0f} ms a frame, {len(frames)} frames of {camera.width}x{camera.height}"
    )
    return epe_px, d1_ratio, coverage


def test_rendered_stereo_against_its_depth(tmp_path):
    scene = rendered(tmp_path, "--size", "640x480", "--seconds", "0.5", "--rate", "2")
    for cfg, limit_px in ((FULL, 0.6), (FAST, 0.9)):
        epe_px, d1_ratio, coverage = figures(cfg, *scene)
        assert (epe_px < limit_px, d1_ratio < 0.03, coverage >= 0.85) == (True, True, True)


@pytest.mark.accuracy
@pytest.mark.parametrize("scene", ["town", "bend", "hill"])
def test_rendered_stereo_at_full_size(tmp_path, scene):
    drive = rendered(tmp_path, "--scene", scene, "--seconds", "5", "--rate", "2")
    epe_px, d1_ratio, coverage = figures(FULL, *drive)
    figures(FAST, *drive)
    assert (epe_px < 0.6, d1_ratio < 0.03, coverage >= 0.85) == (True, True, True)


def test_halving_an_odd_image_counts_its_last_row_and_column_twice():
    image = np.array([[0, 4, 10], [8, 12, 20], [30, 50, 90]], np.uint8)
    np.testing.assert_array_equal(stereo._halved(image), [[6, 15], [40, 90]])
    np.testing.assert_array_equal(stereo._halved(image[:2, :2]), [[6]])
    row = np.array([[0, 2, 4, 6, 9]], np.uint8)
    np.testing.assert_array_equal(stereo._halved(row), [[1, 5, 9]])
    np.testing.assert_array_equal(stereo._halved(row.T), [[1], [5], [9]])
