"""Cameras and labels that the user gives instead of the log's: the results use them, and the output stores them."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from roadperc_stream import log
from roadperc_stream.cli.replay import main
from roadperc_stream.config import ReplayConfig, load_config
from roadperc_stream.config.calibration import CalibrationConfig
from roadperc_stream.errors import ConfigError, RoadpercError
from roadperc_stream.geometry import Camera, mounting
from roadperc_stream.info.examine import examine
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.replaced import LogSensor, given_to, replaced
from roadperc_stream.input.transforms import LatchedState, TransformTree
from roadperc_stream.model import Transform
from roadperc_stream.output import encoding
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.view.rerun.recording import save_recording
from roadperc_stream.view.result_frames import read_frame
from tests import logs
from tests.analytic import box
from tests.replaying import replay

SIZE = {"width": 320, "height": 240}
YAML = """\
image_width: 320
image_height: 240
camera_name: webcam
camera_matrix: {rows: 3, cols: 3, data: [160, 0, 159.5, 0, 160, 119.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""
BARE = ("image", "depth", "segmentation", "detections")


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """A log without calibration and mounting, of a camera with 90 degrees, 1.4 m high."""
    return logs.write(tmp_path_factory.mktemp("bare") / "in.mcap", logs.items(frames=3, roles=BARE))


@pytest.fixture(scope="module")
def calibrated(bare):
    """The metrics of the same log with its calibration and mounting."""
    source = logs.write(bare.with_name("whole.mcap"), logs.items(frames=3))
    replay(source, bare.with_name("whole.out.mcap"), ReplayConfig())
    return metrics(bare.with_name("whole.out.mcap"))


def metrics(target):
    table = pl.read_parquet(sidecar_path(target, "metrics"))
    return table.drop("log_id", *(name for name in table.columns if name.endswith("_ms")))


def zeros(path):
    """The bare log with the calibration of a webcam: all numbers are 0."""
    empty = CameraCalibration(frame_id="camera", K=[0.0] * 9, R=[0.0] * 9, P=[0.0] * 12, **SIZE)
    item = logs.Item("calibration", logs.START_NS, empty.SerializeToString())
    return logs.write(path, [item, *logs.items(frames=3, roles=BARE)])


@pytest.mark.parametrize("calibration", [None, zeros], ids=["no CameraInfo", "zeros"])
def test_a_log_without_a_calibration_names_the_option(bare, tmp_path, calibration):
    source = bare if calibration is None else calibration(tmp_path / "in.mcap")
    with pytest.raises(RoadpercError, match="--fov DEGREES or --calibration FILE"):
        replay(source, tmp_path / "out.mcap", ReplayConfig())


@pytest.mark.parametrize("file", [None, "ost.yaml", "calibration.json"])
@pytest.mark.parametrize("calibration", [None, zeros], ids=["no CameraInfo", "zeros"])
def test_the_options_give_the_camera(bare, calibrated, tmp_path, calibration, file):
    source, target = bare if calibration is None else calibration(tmp_path / "in.mcap"), tmp_path / "out.mcap"
    (tmp_path / "ost.yaml").write_text(YAML)
    (tmp_path / "calibration.json").write_text('{"K": [[160, 0, 160], [0, 160, 120], [0, 0, 1]]}')
    options = ["--fov", "90"] if file is None else ["--calibration", str(tmp_path / file)]
    assert main([str(source), str(target), *options, "--height", "1.4", "--quiet"]) == 0
    assert metrics(target).equals(calibrated)


def test_a_result_replays_itself_without_the_options(bare, tmp_path):
    cfg = load_config(None, ("calibration.fov_deg=90", "calibration.rgb_height_m=1.4", "labels.car=person"))
    first, again = tmp_path / "first.mcap", tmp_path / "again.mcap"
    replay(bare, first, cfg)
    replay(first, again, ReplayConfig())
    assert again.read_bytes() == first.read_bytes()
    inputs = [[m for m in log.read(log.summarise(path)) if not is_result(m.channel)] for path in (bare, first)]
    assert [(m.channel.topic, m.log_time_ns, m.data) for m in inputs[0]] == [
        (m.channel.topic, m.log_time_ns, m.data) for m in inputs[1]
    ]
    other = tmp_path / "other.mcap"
    replay(first, other, load_config(None, ("calibration.fov_deg=60",)))
    assert metrics(other)["camera_height_m"][0] != metrics(first)["camera_height_m"][0]
    given = examine(other, {}).provenance.settings
    assert [item.value for item in given if item.key.startswith("calibration")] == ["60.0", "1.4"]


def test_readers_of_a_result_use_its_calibration(bare, tmp_path):
    """Images are shown as the chain saw them: without the distortion of the given lens."""
    lens = ("calibration.K=[[160,0,160],[0,160,120],[0,0,1]]", "calibration.D=[-0.3,0.1,0,0,0]")
    found = {}
    for name, settings in (("plain", lens[:1]), ("lens", lens)):
        replay(bare, tmp_path / f"{name}.mcap", load_config(None, settings))
        found[name] = read_frame(tmp_path / f"{name}.mcap", logs.START_NS, {}).image_bgr
        assert save_recording(tmp_path / f"{name}.mcap", tmp_path / f"{name}.rrd", {}).frames == 3
    assert not np.array_equal(found["plain"], found["lens"])


def test_a_calibration_of_another_size_is_refused(bare, tmp_path):
    wrong = load_config(None, ("calibration.fov_deg=90", "calibration.width=640", "calibration.height=480"))
    with pytest.raises(RoadpercError, match=r"/camera/front/image: images of 320x240, .* of 640x480"):
        replay(bare, tmp_path / "out.mcap", wrong)


def test_info_uses_the_options(bare):
    cfg = load_config(None, ("calibration.fov_deg=90", "calibration.rgb_height_m=1.4"))
    (camera,) = examine(bare, {}, cfg).replay.cameras
    assert (camera.camera.fx, camera.ego_T_camera[2][3]) == (160.0, 1.4)


def test_labels_are_known_by_the_configuration(bare, tmp_path):
    boxes = [box("Auto", 20, 60, 60, 90), box("Pedestrian", 200, 100, 220, 140)]
    messages = [item for item in logs.items(frames=1) if item.role != "detections"]
    data = encoding.encode_detections(logs.START_NS, "camera", boxes)
    source = logs.write(tmp_path / "in.mcap", [*messages, logs.Item("detections", logs.START_NS, data)])
    (tmp_path / "labels.toml").write_text('[labels]\nauto = "car"\n')
    assert main([str(source), str(tmp_path / "out.mcap"), "--labels", str(tmp_path / "labels.toml"), "--quiet"]) == 0
    objects = pl.read_parquet(tmp_path / "out.objects.parquet")
    assert objects["label"].to_list() == ["car", "Pedestrian"]
    assert objects["class_ratio"].null_count() == 0


def test_a_wrong_file_of_labels_names_the_known_ones(tmp_path):
    with pytest.raises(ConfigError, match=r"caar.*bicycle, bus, car"):
        load_config(None, ("labels.auto=caar",))
    (tmp_path / "labels.toml").write_text('auto = "car"\n')
    assert main(["in.mcap", "out.mcap", "--labels", str(tmp_path / "labels.toml")]) == 1


def shifted(x, z=0.0):
    T = np.eye(4)
    T[0, 3], T[2, 3] = x, z
    return T


@pytest.mark.parametrize("ego", ["ego", "base_link"])
def test_a_given_height_keeps_what_is_mounted_beside_the_camera(ego):
    """The lidar stays where it is seen from the camera, and so does the log's frame of the vehicle."""
    edges = [Transform(ego, "cam", mounting(x=1.5, z=1.0)), Transform(ego, "lidar", shifted(0.0, 2.0))]
    camera = Camera("cam", 320, 240, 160, 160, 159.5, 119.5)
    latched = LatchedState({"calibration": camera}, TransformTree().updated(edges))
    sensors = {"image": LogSensor("/i", "cam", (320, 240)), "lidar": LogSensor("/l", "lidar")}
    given = given_to(sensors, CalibrationConfig(rgb_height_m=1.4), "image")
    tree = replaced(latched, given, "image").tree
    np.testing.assert_allclose(tree.lookup("ego", "cam"), mounting(z=1.4))
    np.testing.assert_allclose(tree.lookup("ego", "lidar"), shifted(-1.5, 2.4), atol=1e-12)


def test_a_camera_that_the_log_describes_as_the_front_one_is_replaced_too():
    wrong = Camera("cam", 320, 240, 57288.0, 57288.0, 160, 120)
    own = replace(wrong, fx=150.0, fy=150.0)
    cameras = {"calibration": wrong, "depth_calibration": replace(wrong, frame_id="depth"), "left_calibration": own}
    given = given_to({"image": LogSensor("/i", "cam", (320, 240))}, CalibrationConfig(fov_deg=90), "image")
    found = replaced(LatchedState(cameras), given, "image").cameras
    assert {role: camera.fx for role, camera in found.items()} == {
        "calibration": 160.0,
        "depth_calibration": 160.0,
        "left_calibration": 150.0,
    }
    assert found["depth_calibration"].frame_id == "depth"


def test_a_pair_is_replaced_as_the_file_says():
    sensors = {"left": LogSensor("/l", "l", (320, 240)), "right": LogSensor("/r", "r", (320, 240))}
    given = given_to(sensors, CalibrationConfig(fov_deg=90, baseline_m=0.12, **SIZE), "left")
    assert given.cameras["right_calibration"].baseline_m == 0.12
    assert {role: camera.frame_id for role, camera in given.cameras.items()} == {
        "left_calibration": "l",
        "right_calibration": "r",
    }


def test_options_replace_the_cameras_and_the_mountings_of_a_record_apart():
    recorded = CalibrationConfig(K=((1, 0, 2), (0, 1, 2), (0, 0, 1)), rgb_height_m=1.2)
    assert CalibrationConfig(fov_deg=60).over(recorded) == CalibrationConfig(fov_deg=60, rgb_height_m=1.2)
    assert CalibrationConfig(rgb_height_m=2).over(recorded) == recorded.model_copy(update={"rgb_height_m": 2.0})
