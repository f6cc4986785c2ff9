from pathlib import Path

import pytest

from roadperc_stream.errors import DumpError
from roadperc_stream.tools.layouts.dump_folder import find_dump
from tests.tools.dump_writer import camera_pixels, document, plain_dump, png


def sources(layout):
    return {role: sensor.source for role, sensor in layout.sensors.items()}


def frames(layout, role):
    return sorted(layout.sensors[role].files)


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (
            ("CameraRGB/frame_00007.png", "CameraRGB/frame_00010.png", "CameraDepth/10.png"),
            {"image": ("CameraRGB", [7, 10]), "depth": ("CameraDepth", [10])},
        ),
        (
            ("image_02/data/0000000003.png", "image_03/data/0000000003.png"),
            {"image": ("image_02", [3]), "right": ("image_03", [3])},
        ),
        (("left.png", "right.png"), {"left": ("left.png", [0]), "right": ("right.png", [0])}),
        (
            ("rgb_0001.png", "0001_depth.png", "rgb_0002.png", "0002_depth.png"),
            {"depth": ("0001_depth.png to 0002_depth.png", [1, 2]), "image": ("rgb_0001.png to rgb_0002.png", [1, 2])},
        ),
        (("000042.png",), {"image": ("000042.png", [42])}),
        (("rgb/0.png", "labels/000000.txt"), {"image": ("rgb", [0]), "detections": ("labels", [0])}),
    ],
    ids=["numbers in names", "KITTI", "flat", "flat, numbers", "bare number", "label text"],
)
def test_names_of_folders_and_files_give_the_sensors(tmp_path, names, found):
    for name in names:
        png(tmp_path / name, camera_pixels())
    layout = find_dump(tmp_path, {})
    assert {role: (source, frames(layout, role)) for role, source in sources(layout).items()} == found


def test_truth_folder_is_a_role_of_its_own(tmp_path):
    plain_dump(tmp_path)
    png(tmp_path / "truth" / "depth" / "000000.png", camera_pixels())
    layout = find_dump(tmp_path, {})
    assert sources(layout)["truth_depth"] == "truth/depth"
    assert sources(layout)["depth"] == "depth"


def test_a_folder_that_fits_no_role_is_mentioned(tmp_path):
    plain_dump(tmp_path)
    png(tmp_path / "fisheye" / "0.png", camera_pixels())
    (tmp_path / "depth_empty").mkdir()
    notes = " ".join(find_dump(tmp_path, {}).notes)
    assert "fisheye/" in notes
    assert "depth_empty/" in notes


def test_a_role_option_wins_over_the_names(tmp_path):
    plain_dump(tmp_path)
    other = png(tmp_path / "far" / "0.png", camera_pixels()).parent
    layout = find_dump(tmp_path, {"depth": other})
    assert frames(layout, "depth") == [0]
    assert layout.sensors["depth"].files[0].parent == other
    assert not any("far" in note for note in layout.notes)


def test_a_role_option_takes_a_folder_from_the_role_of_its_name(tmp_path):
    plain_dump(tmp_path)
    layout = find_dump(tmp_path, {"truth_depth": tmp_path / "depth"})
    assert "depth" not in layout.sensors


def two_depths(folder: Path) -> None:
    plain_dump(folder)
    png(folder / "Camera Depth" / "0.png", camera_pixels())


def one_number_twice(folder: Path) -> None:
    plain_dump(folder)
    png(folder / "rgb" / "1.png", camera_pixels())


def only_junk(folder: Path) -> None:
    png(folder / "holiday" / "1.png", camera_pixels())
    png(folder / "party" / "1.png", camera_pixels())
    (folder / "notes.txt").write_text("hello")


def detections_twice(folder: Path) -> None:
    plain_dump(folder)
    document(folder / "detections.json", {})
    (folder / "label_2").mkdir()
    (folder / "label_2" / "000000.txt").write_text("")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (two_depths, ["Camera Depth", "depth", "--role depth='Camera Depth'"]),
        (one_number_twice, ["000001.png", "1.png", "frame 1", "rename"]),
        (only_junk, ["no sensor found", "holiday/", "notes.txt"]),
        (lambda _: None, ["no sensor found", "found: nothing"]),
        (detections_twice, ["detections.json", "label_2", "--role detections"]),
    ],
)
def test_faults_name_what_is_there(tmp_path, make, words):
    make(tmp_path)
    with pytest.raises(DumpError) as fault:
        find_dump(tmp_path, {})
    assert all(word in str(fault.value) for word in words), fault.value


def test_a_dump_one_folder_further_down_is_found_and_said(tmp_path):
    plain_dump(tmp_path / "run" / "_out")
    (tmp_path / "run" / "config").mkdir()
    layout = find_dump(tmp_path / "run", {})
    assert sources(layout)["image"] == "rgb"
    assert any("_out/" in note for note in layout.notes)
    assert layout.documents["calibration"].parent.name == "_out"
    plain_dump(tmp_path / "run" / "second")
    with pytest.raises(DumpError, match=r"2 folders in it hold frames: pass one, such as .*_out"):
        find_dump(tmp_path / "run", {})


def test_a_role_option_may_name_the_dump_itself(tmp_path):
    plain_dump(tmp_path)
    png(tmp_path / "x_1.png", camera_pixels())
    layout = find_dump(tmp_path, {"image": tmp_path})
    assert frames(layout, "image") == [1]
    assert frames(layout, "depth") == [0, 1, 2]


def test_a_single_file_of_a_role_option_is_its_own_frame(tmp_path):
    plain_dump(tmp_path)
    scan = tmp_path / "scans" / "000001.ply"
    scan.parent.mkdir()
    scan.write_text("ply")
    assert frames(find_dump(tmp_path, {"lidar": scan}), "lidar") == [1]
    assert frames(find_dump(tmp_path, {"lidar": scan.rename(scan.with_name("scan.ply"))}), "lidar") == [0]


def test_circular_links_are_ignored(tmp_path):
    (plain_dump(tmp_path) / "poses.json").symlink_to("poses.json")
    (tmp_path / "lidar").symlink_to("lidar")
    assert set(find_dump(tmp_path, {}).sensors) == {"image", "depth", "segmentation"}


def test_files_without_a_number_are_mentioned(tmp_path):
    plain_dump(tmp_path)
    png(tmp_path / "rgb" / "thumbnail.png", camera_pixels())
    layout = find_dump(tmp_path, {})
    assert frames(layout, "image") == [0, 1, 2]
    assert "thumbnail.png" in layout.notes[0]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(DumpError, match="nowhere: No such file"):
        find_dump(tmp_path / "nowhere", {})


def test_a_link_to_the_folder_itself_is_no_dump_further_down(tmp_path):
    (tmp_path / "run" / "_out").mkdir(parents=True)
    (tmp_path / "run" / "_out" / "_out").symlink_to(tmp_path / "run")
    with pytest.raises(DumpError, match="no sensor found"):
        find_dump(tmp_path / "run", {})
