"""Files of datasets: one function reads them up to a size, and their paths, numbers and poses are checked."""

import gzip
import json
import os

import numpy as np
import pytest

from roadperc_stream.cli import batch, convert
from roadperc_stream.config import load_config
from roadperc_stream.errors import ConfigError, DumpError
from roadperc_stream.eval.criteria import read_criteria
from roadperc_stream.eval.lanes.lane_files import LaneFileError, read_frames, read_list
from roadperc_stream.tools.layouts.carla_files import read_document
from roadperc_stream.tools.networks.description import read_network
from roadperc_stream.tools.readers.calibration_file import load_calibration
from roadperc_stream.tools.readers.detection_files import load_detections
from roadperc_stream.tools.readers.documents import read_json, read_yaml
from roadperc_stream.tools.readers.frame_stamps import stamps_of_file
from roadperc_stream.tools.readers.image_files import read_bytes
from roadperc_stream.tools.readers.pixel_files import file_size
from roadperc_stream.tools.readers.truth_file import load_poses
from tests.eval.tables import outcome
from tests.tools.dump_writer import camera_pixels, jpeg
from tests.tools.layouts.test_kitti_odometry import dataset, numbers, replaced
from tests.tools.layouts.test_lane_labels import tusimple_folder
from tests.tools.layouts.test_routes import carla_matrix, nuscenes, packed

__all__ = ["dataset", "nuscenes"]
NO_FILE = (ConfigError, DumpError, OSError)
LARGE = ("-1e308", "1e999", "9223372036854775808", "nan", "9" * 6000)


@pytest.mark.parametrize(
    "read",
    [load_config, load_calibration, load_detections, load_poses, read_network, read_frames, read_bytes, file_size],
)
def test_only_regular_files_are_read(tmp_path, read):
    pipe, endless = tmp_path / "pipe.bin", tmp_path / "endless.bin"
    os.mkfifo(pipe)
    endless.symlink_to("/dev/zero")
    for path in (pipe, endless):
        with pytest.raises(NO_FILE, match="a pipe or a device"):
            read(path)


def test_a_list_of_logs_is_a_regular_file(tmp_path, capsys):
    code, _, err = outcome(batch.main, capsys, tmp_path / "out", "@/dev/zero")
    assert (code, "a pipe or a device" in err) == (1, True)


def test_a_file_is_read_up_to_a_size(tmp_path):
    path = tmp_path / "a.toml"
    with path.open("wb") as file:
        file.truncate(3_000_000_000)
    for read in (load_config, read_criteria, read_yaml, read_document, read_json):
        with pytest.raises((ConfigError, DumpError), match="is larger than"):
            read(path)


@pytest.mark.parametrize("how", ["parent", "absolute", "link"])
def test_named_paths_stay_below_the_folder(nuscenes, tmp_path, capsys, how):
    """An image outside the folder is never read."""
    secret = tmp_path / "secret.jpg"
    jpeg(secret, camera_pixels())
    rows = nuscenes / "v1.0-mini" / "sample_data.json"
    labels = tusimple_folder(tmp_path / "tusimple") / "label_data_0313.json"
    for folder in (nuscenes, labels.parent):
        (folder / "link.jpg").symlink_to(secret)
    name = {"parent": "../secret.jpg", "absolute": str(secret), "link": "link.jpg"}[how]
    rows.write_text(rows.read_text().replace("samples/CAM_FRONT/970000.jpg", name))
    labels.write_text(labels.read_text().replace("clips/0531/7/20.jpg", name))
    for where, *options in ((nuscenes, "--sequence", "scene-0001"), (labels.parent, "--fov", "60")):
        code, _, err = outcome(convert.main, capsys, where, tmp_path / "o.mcap", *options)
        assert (code, err.count("\n"), "leads out of" in err) == (1, 1, True), err
        assert not (tmp_path / "o.mcap").exists()


@pytest.mark.parametrize("how", ["parent", "link"])
def test_labels_of_a_list_stay_below_the_folder(tmp_path, how):
    (tmp_path / "culane" / "list").mkdir(parents=True)
    (tmp_path / "secret.lines.txt").write_text("1 2 3 4")
    (tmp_path / "culane" / "link.lines.txt").symlink_to(tmp_path / "secret.lines.txt")
    name = {"parent": "list/../../secret.jpg", "link": "link.jpg"}[how]
    listed = tmp_path / "culane" / "list" / "train.txt"
    listed.write_text(f"/{name} 1 1\n")
    with pytest.raises(LaneFileError, match="leads out of"):
        read_list(listed, [name], np.arange(9.0))


@pytest.mark.parametrize("matrix", [np.diag((1, -1, 1)), 2 * np.eye(3), np.zeros((3, 3)), np.diag((-1, -1, -1))])
def test_poses_are_rotations(dataset, nuscenes, tmp_path, capsys, matrix):
    route = tmp_path / "route"
    jpeg(route / "rgb" / "0000.jpg", camera_pixels())
    placed = np.eye(4)
    placed[:3, :3] = matrix
    packed(route / "measurements" / "0000.json.gz", {"theta": 0, "ego_matrix": placed.tolist()})
    replaced(dataset / "poses" / "00.txt", 1, numbers(placed[:3]))
    rows = json.loads((nuscenes / "v1.0-mini" / "ego_pose.json").read_text())
    rows[0]["rotation"] = (matrix[0, 0] * 2.0, 0, 0, 0)
    (nuscenes / "v1.0-mini" / "ego_pose.json").write_text(json.dumps(rows))
    for arguments in ((dataset, "--sequence", "00"), (route,), (nuscenes, "--sequence", "scene-0001")):
        code, _, err = outcome(convert.main, capsys, *arguments, tmp_path / "o.mcap")
        assert (code, err.count("\n"), "expected a rotation" in err) == (1, 1, True), err


@pytest.mark.parametrize("word", LARGE, ids=["negative", "infinite", "2^63", "nan", "6000 digits"])
def test_numbers_have_a_limit(dataset, tmp_path, capsys, word):
    replaced(dataset / "sequences" / "00" / "calib.txt", 2, f"P2: {word} 0 7.5 0 0 8 5.5 0 0 0 1 0")
    route = tmp_path / "route"
    jpeg(route / "rgb" / "0000.jpg", camera_pixels())
    packed(route / "measurements" / "0000.json.gz", {"theta": 0, "ego_matrix": carla_matrix(0, 0)})
    box = {"class": "car", "extent": [2, 1, "W"], "num_points": 3, "id": 7, "matrix": carla_matrix(10, 25)}
    boxes = json.dumps([box]).replace('"W"', word.replace("nan", "NaN"))
    (route / "boxes").mkdir()
    (route / "boxes" / "0000.json.gz").write_bytes(gzip.compress(boxes.encode()))
    for arguments in ((dataset, "--sequence", "00"), (route,)):
        code, _, err = outcome(convert.main, capsys, *arguments, tmp_path / "o.mcap")
        assert (code, err.count("\n"), len(err) < 1000) == (1, 1, True), err
    stamps = tmp_path / "timestamps.txt"
    stamps.write_text(f"1 {word}\n")
    with pytest.raises(DumpError, match="expected 'seconds' or 'frame seconds'"):
        stamps_of_file(stamps, [1])


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("nested.json", b"[" * 100_000),
        ("literal.json", b"{'a': [" + b"[],'" * 300_000 + b"]}"),
        ("bomb.json.gz", gzip.compress(bytes(200_000_000))),
        ("cut.json.gz", gzip.compress(b"[1, 2]")[:-9]),
    ],
    ids=["nested", "literal", "gzip", "cut"],
)
def test_documents_do_not_expand(tmp_path, name, data):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(DumpError, match=name) as fault:
        read_document(path)
    assert len(str(fault.value)) < 1000
    if not name.endswith("gz"):
        with pytest.raises(DumpError, match="not JSON"):
            load_detections(path)
