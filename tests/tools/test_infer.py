"""``roadperc-infer`` on frames of a real video, with real networks."""

import shutil
from pathlib import Path

import cv2
import pytest

from roadperc_stream import log
from roadperc_stream.cli.infer import main

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


def test_the_log_has_channels_tag_table_and_digests(drive):
    summary = log.summarise(drive / "out.mcap")
    (table,) = [found for c in summary.channels if (found := c.label("tag_table"))]
    assert table == "classes:unlabeled,road,road_line"
    values = {key: value for record in summary.metadata for key, value in record.values}
    assert values["segmentation.sha256"].startswith("9548df62")
    assert values["detections.sha256"].startswith("695e750a")


def test_results_are_replaced_only_with_force_and_do_not_depend_on_threads(drive, capsys):
    assert infer(drive, drive / "out.mcap", "again.mcap") == 1
    assert "pass --force to replace it" in capsys.readouterr().err
    assert not (drive / "again.mcap").exists()
    for name, threads in (("1.mcap", 1), ("2.mcap", 2)):
        assert infer(drive, drive / "out.mcap", name, "--force", "--threads", threads) == 0
    assert (drive / "1.mcap").read_bytes() == (drive / "2.mcap").read_bytes()


def test_check_writes_a_picture(drive):
    assert main(["--check", str(drive / "twinlitenet.toml"), str(drive / "shots/0.jpg"), str(drive / "seen.png")]) == 0
    assert cv2.imread(str(drive / "seen.png")).shape[0] > 800
