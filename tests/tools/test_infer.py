"""``roadperc-infer`` on frames of a real video, with real networks."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import polars as pl
import pytest
from rosbags.rosbag2 import StoragePlugin

from roadperc_stream import log
from roadperc_stream.cli import degrade, replay
from roadperc_stream.cli.infer import main
from roadperc_stream.log import LogWriter
from roadperc_stream.tools.networks.description import read_network
from roadperc_stream.tools.networks.frames import load
from tests.input import test_elsewhere as elsewhere
from tests.log.test_bags import split_bag
from tests.tools.test_video_logs import TOPIC, write_log

ANNEX_B = (cv2.CAP_PROP_FORMAT, -1)
IMAGE_TOPICS = {"/camera/front/image", "/camera/front/calibration"}
DOCS = Path(__file__).parents[2] / "docs" / "networks"


@pytest.fixture(scope="module")
def drive(data_dir, tmp_path_factory):
    """Folder with a blank in its name: three frames, two networks, and the log inferred from them."""
    folder = tmp_path_factory.mktemp("my drive")
    capture = cv2.VideoCapture(str(data_dir / "highway_video" / "solidWhiteRight.mp4"))
    (folder / "shots").mkdir()
    for number in range(3):
        cv2.imwrite(str(folder / "shots" / f"{number}.jpg"), capture.read()[1])
    for name in ("twinlitenet", "yolox_nano"):
        shutil.copy(DOCS / f"{name}.toml", folder)
        shutil.copy(data_dir / "networks" / f"{name}.onnx", folder)
    assert infer(folder, folder / "shots", "out.mcap", "--fov", 55, "--height", 1.3) == 0
    return folder


def infer(folder, source, name, *options):
    networks = [word for key in ("twinlitenet", "yolox_nano") for word in ("--network", folder / f"{key}.toml")]
    return main([str(word) for word in (source, folder / name, *networks, "--quiet", *options)])


def test_the_log_has_channels_tag_table_and_digests_and_check_writes_a_picture(drive):
    assert main(["--check", str(drive / "twinlitenet.toml"), str(drive / "shots/0.jpg"), str(drive / "seen.png")]) == 0
    assert cv2.imread(str(drive / "seen.png")).shape[0] > 800
    summary = log.summarise(drive / "out.mcap")
    (table,) = [found for c in summary.channels if (found := c.label("tag_table"))]
    assert table == "classes:unlabeled,road,road_line"
    values = {key: value for record in summary.metadata for key, value in record.values}
    assert values["segmentation.sha256"].startswith("9548df62")
    assert values["detections.sha256"].startswith("695e750a")


def test_the_output_of_a_log_stores_the_calibration_that_the_options_give(drive):
    """As does that of roadperc-degrade."""
    images = [m for m in log.read(log.summarise(drive / "out.mcap")) if m.channel.topic == "/camera/front/image"]
    with LogWriter(drive / "bare.mcap") as writer:
        for message in images:
            writer.write(message)
    assert infer(drive, drive / "bare.mcap", "given.mcap", "--fov", 55, "--height", 1.3) == 0
    degraded = [str(drive / "given.mcap"), str(drive / "degraded.mcap"), "--with", "contrast=1", "--quiet"]
    assert degrade.main(degraded) == 0
    found = {}
    for name in ("out", "given", "degraded"):
        target = drive / f"{name}.replayed.mcap"
        assert replay.main([str(drive / f"{name}.mcap"), str(target), "--quiet"]) == 0
        found[name] = pl.read_parquet(drive / f"{name}.replayed.metrics.parquet")["camera_height_m"].to_list()
    assert all(heights == pytest.approx([1.3] * 3, rel=1e-12) for heights in found.values())


def test_a_log_with_only_video_is_converted_first(drive, data_dir):
    capture = cv2.VideoCapture(str(data_dir / "highway_video" / "solidWhiteRight.mp4"), cv2.CAP_FFMPEG, ANNEX_B)
    path = write_log(drive / "video.mcap", [capture.read()[1].tobytes() for _ in range(2)])
    assert infer(drive, path, "images.mcap") == 0
    found = messages(drive / "images.mcap")
    assert len(found["/camera/front/segmentation"]) == len(found[TOPIC]) == 2
    path.unlink()


def test_a_split_bag_is_read_directly(drive):
    whole = [m for m in log.read(log.summarise(elsewhere.SAMPLE)) if m.channel.topic in IMAGE_TOPICS][:3]
    single = elsewhere.bag(drive / "bag.mcap", whole)
    folder = split_bag(drive / "bag", [*log.read(log.summarise(single))], StoragePlugin.SQLITE3)
    assert infer(drive, single, "single.mcap") == infer(drive, folder, "split.mcap") == 0
    assert messages(drive / "single.mcap") == messages(drive / "split.mcap")


def test_results_are_replaced_only_with_force_and_do_not_depend_on_threads(drive, capsys):
    assert infer(drive, drive / "out.mcap", "again.mcap") == 1
    assert "pass --force to replace it" in capsys.readouterr().err
    assert not (drive / "again.mcap").exists()
    for name, threads in (("1.mcap", 1), ("2.mcap", 2)):
        assert infer(drive, drive / "out.mcap", name, "--force", "--threads", threads) == 0
    assert (drive / "1.mcap").read_bytes() == (drive / "2.mcap").read_bytes()


def test_an_image_wider_than_two_to_one_has_the_lanes_of_the_whole_image(drive, data_dir):
    pair = load([read_network(drive / "twinlitenet.toml")])
    whole = cv2.imread(str(drive / "shots/0.jpg"))
    seen, wide = pair.raw(whole).masks, pair.raw(whole[230:520]).masks
    for name, least in (("road", 0.75), ("road_line", 0.75)):
        found, true = wide[name], seen[name][230:520]
        assert (found & true).sum() > least * (found | true).sum()
    kitti = pair.raw(cv2.imread(str(data_dir / "kitti_odometry" / "image_0" / "000010.png"))).masks
    assert kitti["road"].mean() > 0.05
    assert kitti["road_line"].mean() > 0.003


def messages(path):
    """Log time, sequence and bytes of each message, by topic."""
    found = {}
    for message in log.read(log.summarise(path)):
        found.setdefault(message.channel.topic, []).append((message.log_time_ns, message.sequence, message.data))
    return found


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ((), "SHA-256 55b4431f"),
        (
            (("sha256", "#"), ("[320, 320]", "[360, 640]"), ("drivable_area", "424"), ("lanes", "439")),
            "input of 360 columns and 640 rows is portrait, but the images are landscape (960x540)",
        ),
    ],
)
def test_the_wrong_export_is_an_error(drive, data_dir, capsys, changes, words):
    text = (drive / "twinlitenet.toml").read_text().replace("twinlitenet.onnx", "twinnetlite.onnx", 1)
    for old, new in changes:
        text = text.replace(old, new, 1)
    (drive / "wrong.toml").write_text(text)
    shutil.copyfile(data_dir / "networks" / "twinnetlite.onnx", drive / "twinnetlite.onnx")
    out = drive / "wrong.mcap"
    assert main([str(w) for w in (drive / "out.mcap", out, "--network", drive / "wrong.toml", "--force")]) == 1
    error = capsys.readouterr().err
    assert words in error
    assert str(drive / "wrong.toml") in error
    assert not out.exists()


def test_an_interrupted_inference_leaves_no_file(drive):
    before = set(drive.iterdir())
    networks = [str(word) for word in ("--network", drive / "twinlitenet.toml", "--threads", 1)]
    command = [sys.executable, "-c", "from roadperc_stream.cli.launch import infer; raise SystemExit(infer())"]
    words = [str(drive / "shots"), str(drive / "stopped.mcap"), "--fov", "55", *networks]
    ran = subprocess.Popen([*command, *words], stderr=subprocess.PIPE, text=True)
    while ran.poll() is None and not any(p.stat().st_size for p in drive.glob(".stopped.mcap.*.partial")):
        time.sleep(0.01)
    ran.send_signal(signal.SIGINT)
    error = ran.communicate(timeout=60)[1]
    assert (ran.returncode, error) == (1, "error: interrupted\n")
    assert set(drive.iterdir()) == before


def test_detections_that_no_class_can_judge_are_kept_and_counted(drive):
    paths = [str(drive / name) for name in ("out.mcap", "replayed.mcap")]
    assert replay.main([*paths, "--only", "objects", "--quiet"]) == 0
    rows = pl.read_parquet(drive / "replayed.metrics.parquet")
    assert rows["detections"].min() >= 2
    assert rows["detections_kept"].to_list() == rows["detections"].to_list() == rows["detections_unjudged"].to_list()
    assert pl.read_parquet(drive / "replayed.objects.parquet")["class_ratio"].null_count() == rows["detections"].sum()


def test_without_onnxruntime_opencv_says_what_to_install(drive, data_dir, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    shutil.copy(data_dir / "networks" / "twinlitenet_preprocessed_quantized_dynamic.onnx", drive / "quantised.onnx")
    text = (
        (drive / "twinlitenet.toml").read_text().replace("sha256", "#").replace("twinlitenet.onnx", "quantised.onnx", 1)
    )
    (drive / "quantised.toml").write_text(text.replace("[320, 320]", "[320, 160]"))
    words = drive / "out.mcap", drive / "cv.mcap", "--network", drive / "quantised.toml", "--force"
    assert main([str(word) for word in words]) == 1
    assert "pip install '.[networks]'" in capsys.readouterr().err
