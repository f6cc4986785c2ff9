"""The Python API gives the same results as the commands."""

import pydoc
import subprocess
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import roadperc_stream as rp
from roadperc_stream.input.arrays import depth_image
from roadperc_stream.model import Object, Objects
from roadperc_stream.output.tables import sidecar_path
from tests import logs

SAMPLE = Path(__file__).parents[1] / "logs" / "sample.mcap"
CAMERA = rp.Camera("camera", 320, 240, 200.0, 200.0, 159.5, 119.5)
STEP_NS = 50_000_000


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    target = tmp_path_factory.mktemp("run") / "out.mcap"
    summary = rp.replay(str(SAMPLE), str(target), config={"lanes": {"hold_s": 0.8}}, max_frames=5)
    assert summary.frames == 5
    return target


def test_frames_are_those_of_a_replay(run):
    found = list(rp.frames(SAMPLE, config={"lanes": {"hold_s": 0.8}}, max_frames=5))
    table = rp.read_metrics(run)
    assert [frame.metrics.stamp_ns for frame in found] == table["stamp_ns"].to_list()
    for column in ("lane_left_offset_m", "camera_height_m", "odom_x_m", "step_error_m", "time_to_impact_s"):
        assert [getattr(frame.metrics, column) for frame in found] == table[column].to_list(), column
    assert found[0].input.stamp_ns == found[0].result.stamp_ns
    assert found[0].truth.lanes is not None


def test_metrics_are_the_table_beside_the_log(run):
    assert rp.read_metrics(run).equals(pl.read_parquet(sidecar_path(run, "metrics")))
    assert rp.read_metrics(str(sidecar_path(run, "metrics"))).height == 5


def test_metrics_of_nothing_name_the_table(tmp_path):
    with pytest.raises(rp.RoadpercError, match=r"none\.metrics\.parquet: no such metrics table$"):
        rp.read_metrics(tmp_path / "none.mcap")
    with pytest.raises(rp.RoadpercError, match=r"expected a metrics table, found a folder$"):
        rp.read_metrics(tmp_path)
    (tmp_path / "bad.parquet").write_bytes(b"no table")
    with pytest.raises(rp.RoadpercError, match=r"bad\.parquet: not a readable metrics table"):
        rp.read_metrics(tmp_path / "bad.parquet")


def test_a_configuration_in_any_form(tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text("[lanes]\nhold_s = 0.8\n", encoding="utf-8")
    loaded = rp.load_config(file)
    for config in (loaded, file, str(file), {"lanes": {"hold_s": 0.8}}):
        chain = rp.Chain(CAMERA, config)
        assert chain._cfg == loaded
    with pytest.raises(rp.RoadpercError, match=r"no setting lanes\.hold; did you mean lanes\.hold_s\?"):
        rp.Chain(CAMERA, {"lanes": {"hold": 1}})


def road(height_m=1.5):
    """Depth and tags (CARLA 0.9.15) of a straight lane with lines 1.8 m to either side."""
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    with np.errstate(divide="ignore"):
        depth_m = np.where(rows > CAMERA.cy, CAMERA.fy * height_m / (rows - CAMERA.cy), np.nan)
    depth_m[depth_m > 60] = np.nan
    lateral_m = -(columns - CAMERA.cx) / CAMERA.fx * depth_m
    tags = np.full(CAMERA.size, 11, np.uint8)
    tags[np.abs(lateral_m) < 6] = 2
    tags[np.abs(lateral_m) < 3.5] = 1
    tags[np.abs(np.abs(lateral_m) - 1.8) < 0.1] = 24
    return depth_m.astype(np.float32), tags


def test_the_chain_on_arrays_measures_what_was_drawn():
    chain = rp.Chain(CAMERA, tag_table="0.9.15")
    depth_m, tags = road()
    for frame in range(3):
        result = chain.step(frame * STEP_NS, depth_m=depth_m, tags=tags)
    assert result.surface.camera_height_m == pytest.approx(1.5, abs=0.005)
    assert result.lanes.side("left").offset_m == pytest.approx(1.7, abs=0.03)
    assert result.lanes.side("right").offset_m == pytest.approx(-1.7, abs=0.03)
    assert depth_m.flags.writeable


def test_a_chain_counts_segments_and_refuses_the_same_stamp_twice():
    chain = rp.Chain(CAMERA)
    for stamp_ns, segment in ((0, 0), (STEP_NS, 0), (3601 * 10**9, 1), (STEP_NS, 2)):
        result = chain.step(stamp_ns)
        assert chain.segment == segment
    assert "time: went back from 3601000000000 to 50000000 ns, state of all stages cleared" in map(str, result.problems)
    with pytest.raises(ValueError, match=r"stamp_ns: 50000000 is also the last frame's; pass a later one, or call"):
        chain.step(STEP_NS)
    chain.reset()
    chain.step(STEP_NS)
    assert chain.segment == 0


def test_the_caller_may_use_the_arrays_again():
    depth_m, tags = road()
    first, second = rp.Chain(CAMERA, tag_table="0.9.15"), rp.Chain(CAMERA, tag_table="0.9.15")
    expected = first.step(0, depth_m=depth_m, tags=tags)
    found = second.step(0, depth_m=depth_m, tags=tags)
    depth_m[:], tags[:] = 1.0, 0
    assert found.lanes.side("left").offset_m == expected.lanes.side("left").offset_m
    assert np.array_equal(found.drivable, expected.drivable)


def test_detections_are_filtered_and_measured():
    depth_m, tags = road()
    depth_m[100:140, 150:180], tags[100:140, 150:180] = 12.0, 14
    car = rp.Detection("car", rp.Box(150, 100, 180, 140), 0.9)
    phantom = rp.Detection("car", rp.Box(10, 10, 40, 40), 0.9)
    result = rp.Chain(CAMERA, tag_table="0.9.15").step(0, depth_m=depth_m, tags=tags, detections=[car, phantom])
    found, dropped = result.objects.objects
    assert (found.kept, dropped.kept) == (True, False)
    assert found.distance_m == pytest.approx(12.0, abs=0.3)


def test_an_absent_output_says_why():
    lanes = rp.Chain(CAMERA).step(0).lanes
    assert isinstance(lanes, rp.Absent)
    assert str(lanes) == "lanes: no segmentation"


def test_a_frame_fits_on_a_screen():
    _, frame = rp.frames(SAMPLE, max_frames=2)
    assert str(frame) == f"frame 1: {frame.result}"
    assert frame.result.odometry.matches is not None
    assert len(repr(frame.result.odometry)) < 1000
    assert len(repr(frame.result.lanes)) < 2000
    assert "array" not in repr(frame.input.image)
    assert len(repr(frame)) < 22_000


def test_a_pose_makes_the_camera_mounted():
    pose = np.array([[0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 2.0], [0, 0, 0, 1]], float)
    result = rp.Chain(CAMERA, ego_T_camera=pose).step(0)
    assert result.surface.camera_height_m == pytest.approx(2.0)


def test_grey_and_colour_are_the_same_image_to_the_chain():
    rng = np.random.default_rng(1)
    grey = rng.integers(0, 255, CAMERA.size, np.uint8)
    depth_m, _ = road()
    poses = []
    for image in (grey, np.repeat(grey[..., None], 3, axis=2)):
        chain = rp.Chain(CAMERA)
        chain.step(0, image=image, depth_m=depth_m)
        poses.append(chain.step(STEP_NS, image=image, depth_m=depth_m).odometry.odom_T_ego)
    assert np.array_equal(*poses)


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        (
            {"depth_m": np.zeros((10, 10), np.float32)},
            r"depth_m: expected \(240, 320\) of the camera, found \(10, 10\)",
        ),
        ({"tags": np.zeros((240, 320), np.float32)}, "tags: expected integers of 0 to 255, found float32"),
        ({"image": np.zeros((240, 320, 4), np.uint8)}, r"image: expected \(240, 320\) or \(240, 320, 3\)"),
        ({"image": np.zeros((240, 320, 3))}, "image: expected uint8, found float64"),
        ({"image": np.full((240, 320), 300, np.uint16)}, "image: expected uint8, found uint16"),
        ({"tags": np.full((240, 320), -1)}, "tags: expected integers of 0 to 255, found int64, -1 to -1"),
        (
            {"depth_m": np.full((240, 320), 12_000, np.uint16)},
            "depth_m: expected metres as float32, found uint16: divide millimetres by 1000",
        ),
        (
            {"detections": [rp.Detection("car", rp.Box(50, 50, 10, 10), 0.9)]},
            r"detections\[0\]: expected x_min <= x_max .*, found Box\(x_min=50",
        ),
        (
            {"detections": [rp.Detection("car", rp.Box(0, 0, 10, float("nan")), 0.9)]},
            r"detections\[0\]: expected .*y_min <= y_max",
        ),
    ],
)
def test_arrays_of_another_shape_or_type_are_refused(inputs, message):
    with pytest.raises(ValueError, match=message):
        rp.Chain(CAMERA, tag_table="0.9.15").step(0, **inputs)


def test_tags_without_a_table_and_an_invalid_pose_are_refused():
    with pytest.raises(rp.RoadpercError, match="tags: no tag table; pass one"):
        rp.Chain(CAMERA).step(0, tags=np.zeros((240, 320), np.uint8))
    with pytest.raises(ValueError, match=r"ego_T_camera: expected \(4, 4\) finite numbers, found \(3, 3\)"):
        rp.Chain(CAMERA, ego_T_camera=np.eye(3))


@pytest.mark.parametrize(
    ("stamp_ns", "detections", "message"),
    [
        (0.05, None, "stamp_ns: expected whole nanoseconds, found 0.05"),
        ("1", None, "stamp_ns: expected whole nanoseconds, found '1'"),
        (0, [("car", 0.9, (1, 2, 3, 4))], r"detections\[0\]: expected a Detection, found \('car'"),
        (0, [rp.Detection("car", (1, 2, 3, 4), 0.9)], r"detections\[0\]: expected box_px to be a Box, found \(1, 2"),
    ],
)
def test_a_stamp_or_detection_of_another_type_is_refused(stamp_ns, detections, message):
    with pytest.raises(TypeError, match=message):
        rp.Chain(CAMERA).step(stamp_ns, detections=detections)


@pytest.mark.parametrize("camera", ["cam", np.eye(3)])
def test_a_camera_of_another_type_is_refused(camera):
    with pytest.raises(TypeError, match=r"^camera: expected a Camera, found (str|ndarray)"):
        rp.Chain(camera)
    with pytest.raises(TypeError, match=r"right_camera: expected a Camera, found (str|ndarray)"):
        rp.Chain(CAMERA, right_camera=camera)


def test_a_camera_with_invalid_numbers_is_refused():
    with pytest.raises(ValueError, match=r"camera: fx 0: expected 0\.32 to 320000 pixels"):
        rp.Chain(rp.Camera("camera", 320, 240, 0, 200, 159.5, 119.5))
    with pytest.raises(ValueError, match="camera: expected an image of one pixel or more, found 0x240"):
        rp.Chain(rp.Camera("camera", 0, 240, 200, 200, 159.5, 119.5))


def test_stamps_and_tags_may_be_of_any_integer_type():
    depth_m, tags = road()
    expected = rp.Chain(CAMERA, tag_table="0.9.15").step(7, depth_m=depth_m, tags=tags)
    for kind in (np.int64, np.uint16):
        found = rp.Chain(CAMERA, tag_table="0.9.15").step(np.int64(7), depth_m=depth_m, tags=tags.astype(kind))
        assert type(found.stamp_ns) is int
        assert found.lanes.side("left").offset_m == expected.lanes.side("left").offset_m


def test_help_names_the_type_of_arrays():
    text = pydoc.render_doc(rp.Chain)
    assert "ArrayLike | None" in text
    assert "_SupportsArray" not in text


def test_importing_the_package_imports_nothing_else():
    code = "import sys, roadperc_stream as rp; dir(rp);"
    code += "print(sorted(sys.modules.keys() & {'numpy', 'cv2', 'polars', 'typing'}))"
    ended = subprocess.run(
        [sys.executable, "-S", "-c", code], capture_output=True, text=True, check=True, cwd=SAMPLE.parents[1]
    )
    assert ended.stdout.strip() == "[]"
    assert rp.__version__
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        rp.nothing  # noqa: B018


def test_every_public_name_is_there():
    for name in rp.__all__:
        assert getattr(rp, name) is not None


@pytest.mark.parametrize("nothing", [0.0, -1.0, -np.inf, np.nan])
def test_invalid_depth_is_unknown(nothing):
    """Zero, negative and infinite depths count as NaN."""
    depth_m = np.full((240, 320), 20.0, np.float32)
    depth_m[200:204, 100:110] = nothing
    taken = depth_image(depth_m, CAMERA).depth_m
    assert np.isnan(taken[200:204, 100:110]).all()
    assert np.isfinite(taken).sum() == depth_m.size - 40
    assert (depth_m[0, 0], taken[0, 0]) == (20.0, 20.0)


def test_a_mounting_has_the_signs_of_its_page():
    assert np.allclose(rp.mounting(1, 2, 3) @ (0, 0, 10, 1), (11, 2, 3, 1))  # 10 m ahead of the camera
    assert np.allclose(rp.mounting()[:3, :3] @ (1, 2, 3), (3, -1, -2))  # camera: right, down, ahead
    sine, cosine = np.sin(np.radians(10)), np.cos(np.radians(10))
    assert np.allclose(rp.mounting(pitch=10)[:3, 2], (cosine, 0, -sine))  # looks down
    assert np.allclose(rp.mounting(yaw=10)[:3, 2], (cosine, sine, 0))  # looks to the left
    assert np.allclose(rp.mounting(roll=10)[:3, 0], (0, -cosine, -sine))  # its right side is down
    with pytest.raises(ValueError, match="mounting: expected finite numbers"):
        rp.mounting(yaw=float("nan"))


@pytest.mark.parametrize(
    ("pose", "found"),
    [(np.eye(4), "up, 90 degrees"), (rp.mounting(yaw=180), "back, 180 degrees")],
    ids=["axes", "back"],
)
def test_a_camera_that_does_not_look_ahead_is_refused(pose, found):
    with pytest.raises(ValueError, match=f"the camera looks {found} from ego's x; .* pass rp.mounting"):
        rp.Chain(CAMERA, ego_T_camera=pose)


def test_a_result_prints_as_one_line():
    depth_m, tags = road()
    result = rp.Chain(CAMERA, tag_table="0.9.15").step(0, depth_m=depth_m, tags=tags)
    assert str(result.lanes).startswith("lanes: left measured at +1.7")
    assert str(result.surface).startswith("surface: depth, camera 1.50 m above the road, pitch ")
    assert "\n" not in str(result)
    assert str(result).endswith("; objects: no detections; odometry: no image")
    car = Object(rp.Detection("car", rp.Box(0, 0, 4, 4), score=1.0), kept=True, distance_m=12.34)
    assert str(Objects((car,))) == f"objects: 1 of 1 kept, nearest: {car}"
    assert str(car) == "car at 12.3 m"


def test_a_log_written_from_frames_replays_to_the_same_results(tmp_path):
    """All inputs of the chain come back bit by bit, the truth up to the rounding of poses as quaternions."""
    copy = tmp_path / "copy.mcap"
    assert rp.write_log(copy, rp.frames(SAMPLE, max_frames=6)) == 6
    with pytest.raises(rp.RoadpercError, match=r"copy\.mcap: exists; pass force=True to overwrite it"):
        rp.write_log(copy, [])
    for ours, theirs in zip(*(rp.frames(path, max_frames=6) for path in (SAMPLE, copy)), strict=True):
        assert np.array_equal(ours.input.image.bgr, theirs.input.image.bgr)
        assert str(ours.result) == str(theirs.result)
        for column, value in vars(ours.metrics).items():
            if column != "log_id":
                expected = pytest.approx(value, rel=1e-9) if isinstance(value, float) else value
                assert getattr(theirs.metrics, column) == expected, column


def test_arrays_are_written_drawn_and_stepped_as_one_frame(tmp_path):
    depth_m, tags = road()
    image = np.full((240, 320, 3), (200, 10, 10), np.uint8)
    box = rp.Detection("car", rp.Box(10, 10, 40, 40), 0.9)
    chain = rp.Chain(CAMERA, tag_table="0.9.15", ego_T_camera=rp.mounting(z=1.5, pitch=1))
    frames = [chain.frame(k * STEP_NS, image=image, depth_m=depth_m, tags=tags, detections=[box]) for k in range(3)]
    assert rp.write_log(str(tmp_path / "in.mcap"), frames) == 3
    for frame, replayed in zip(frames, rp.frames(tmp_path / "in.mcap"), strict=True):
        result = chain.step(frame)
        assert str(result) == str(replayed.result)
        picture = rp.draw(frame, result)
        assert (picture.shape, picture.dtype) == ((240, 320, 3), np.uint8)
        assert picture[5, 300].tolist() == [10, 10, 200], "red, green, blue"
        assert np.array_equal(picture, rp.draw(replayed))
        assert replayed._repr_png_().startswith(b"\x89PNG")
        assert "lanes" in result._repr_html_()
    with pytest.raises(TypeError, match="step: pass a frame or arrays, not both"):
        chain.step(frames[0], image=image)
    with pytest.raises(rp.RoadpercError, match=r"none\.mcap: expected one frame or more, found none"):
        rp.write_log(tmp_path / "none.mcap", [])
    with pytest.raises(TypeError, match=r"draw: expected a result; pass rp\.draw\(frame, chain\.step\(frame\)\)"):
        rp.draw(frames[0])
    with pytest.raises(
        rp.RoadpercError, match=r"none\.mcap: frame with stamp -1 ns, expected 0 to 18446744073709551615"
    ):
        rp.write_log(tmp_path / "none.mcap", [chain.frame(-1, image=image)])
    assert {path.name for path in tmp_path.iterdir()} == {"in.mcap"}


def test_frames_name_the_argument_for_a_log_without_calibration(tmp_path):
    path = logs.write(tmp_path / "in.mcap", logs.items(2, roles={"image"}))
    with pytest.raises(rp.RoadpercError, match=r"pass config=\{\"calibration\": \{\"fov_deg\": DEGREES\}\} for a log"):
        next(iter(rp.frames(path)))
    assert next(iter(rp.frames(path, config={"calibration": {"fov_deg": 90}}))).metrics.frame == 0


def test_a_frame_without_an_image_is_drawn_over_its_depth_else_over_black():
    depth_m, tags = road()
    chain = rp.Chain(CAMERA, tag_table="0.9.15")
    with_depth, bare = chain.frame(0, depth_m=depth_m, tags=tags), chain.frame(STEP_NS)
    red, _, blue = rp.draw(with_depth, chain.step(with_depth))[235, 5].tolist()
    assert red > blue
    assert not rp.draw(bare, rp.Chain(CAMERA).step(bare)).any()
