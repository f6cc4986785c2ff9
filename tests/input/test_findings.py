"""Findings that the input alone shows, in a replay, in roadperc-info and in roadperc-convert."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream import replay
from roadperc_stream.cli.convert import main as convert_main
from roadperc_stream.cli.info import main as info_main
from roadperc_stream.cli.render import main as render_main
from roadperc_stream.config import load_config
from roadperc_stream.formats import images
from roadperc_stream.geometry import Camera, mounting
from roadperc_stream.info.examine import examine
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.input.findings import camera_findings, label_findings
from roadperc_stream.model import Transform
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE
from roadperc_stream.output import encoding
from tests import logs
from tests.analytic import STEP_NS, box
from tests.test_sample import SAMPLE

CAMERA = Camera("cam", 320, 240, 160, 160, 159.5, 119.5)


def findings_of(path, *settings, **source):
    """The findings of a replay's input by their code; info shows the same."""
    opened = open_input(ReplaySource(path, **source), load_config(None, settings))
    assert opened.findings == ()
    for _ in opened.samples():
        pass
    found = {finding.code: finding.text for finding in opened.findings}
    shown = examine(path, source.get("overrides", {}), opened.cfg).replay.findings
    assert {finding.code: finding.text for finding in shown} == found
    return found


def log_with(path, *changed, frames=3):
    """A healthy log with other messages of some roles."""
    roles = {item.role for item in changed}
    return logs.write(path, [*changed, *(item for item in logs.items(frames=frames) if item.role not in roles)])


def item(role, encode, *content, k=0):
    stamp_ns = logs.START_NS + k * STEP_NS
    return logs.Item(role, stamp_ns, encode(stamp_ns, *content))


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({}, None),
        ({"fx": 57288.0, "fy": 57288.0}, "field_of_view"),
        ({"fx": 20.0, "fy": 20.0}, "field_of_view"),
        ({"cx": 20.0}, "principal_point"),
        ({"cy": 200.0}, "principal_point"),
        ({"baseline_m": 0.54}, None),
        ({"baseline_m": 120.0}, "stereo_baseline"),
    ],
)
def test_a_camera_beyond_any_lens_is_found(changed, code):
    found = list(camera_findings("/cam", replace(CAMERA, **changed), "--fov DEGREES"))
    assert [finding.code for finding in found] == [code] * (code is not None)
    assert all("/cam: " in finding.text and ("--fov" in finding.text or "--cal" in finding.text) for finding in found)


def test_the_field_of_view_of_a_log_is_found_and_mended(tmp_path):
    wrong = replace(logs.SMALL.camera, fx=57288.0, fy=57288.0)
    source = log_with(tmp_path / "in.mcap", item("calibration", encoding.encode_calibration, wrong))
    text = findings_of(source)["field_of_view"]
    assert all(word in text for word in ("/camera/front/image", "0.3 degrees", "--fov DEGREES", "--calibration FILE"))
    assert findings_of(source, "calibration.fov_deg=90") == {}
    assert findings_of(source, "calibration.fov_deg=1.2").keys() == {"field_of_view"}


def edges(*named):
    return item("tf", encoding.encode_transforms, [Transform(*names, mounting(z=1.0)) for names in named])


@pytest.mark.parametrize(
    ("named", "code"),
    [
        ([("base_link", "camera")], None),
        ([("/base_link", "/camera")], None),
        ([("map", "mast"), ("mast", "camera")], "camera_transform"),
        ([("odom", "base_link")], "camera_transform"),
        ([("camera", "lens")], "camera_transform"),
    ],
    ids=["mounted", "slashes", "other names", "no camera", "camera alone"],
)
def test_transforms_that_lead_nowhere_are_found(tmp_path, named, code):
    found = findings_of(log_with(tmp_path / "in.mcap", edges(*named)))
    assert found.keys() == ({code} if code else set())
    if code:
        assert all(word in found[code] for word in ("'camera'", repr(named[0][1]), "1.5 m", "--height"))


def test_without_transforms_the_height_is_no_contradiction(tmp_path):
    roles = [role for role in logs.ALL if role != "tf"]
    assert findings_of(logs.write(tmp_path / "in.mcap", logs.items(frames=1, roles=roles))) == {}


def test_a_lidar_without_a_transform_is_found(tmp_path):
    cloud = item("lidar", encoding.encode_points, "velodyne", np.ones((5, 3), np.float32))
    found = findings_of(log_with(tmp_path / "in.mcap", cloud))
    assert "'velodyne'" in found["lidar_transform"]


def test_unknown_labels_are_counted_and_mapped(tmp_path):
    boxes = [box(label, 20, 60, 60, 90) for label in ("auto", "Mensch", "3", "Car", "Misc")]
    source = log_with(
        tmp_path / "in.mcap", *(item("detections", encoding.encode_detections, "camera", boxes, k=k) for k in (0, 1))
    )
    text = findings_of(source)["labels"]
    assert all(word in text for word in ("6 of 10", "'auto' (2)", "'Mensch' (2)", "'3' (2)", "--labels"))
    known = "labels.Auto=car", "labels.mensch=person", "labels.3=truck"
    assert findings_of(source, *known) == {}
    assert "2 of 10" in findings_of(source, *known[:2])["labels"]


def test_any_number_of_labels_is_one_line():
    (found,) = label_findings("/boxes", Counter({f"label {k} \x1b" * 99: 1 for k in range(900)}), 900)
    assert len(found.text) < 900
    assert found.text.isprintable()


def mask(k, tags):
    png = images.encode_indices(tags.astype(np.uint8), TABLE.colours)
    return item("segmentation", encoding.encode_image, "camera", "png", png, k=k)


@pytest.mark.parametrize(
    ("tags", "code"), [((7, 8), None), ((7, 24), "tags"), ((0, 0), "single_tag")], ids=["known", "beyond", "single"]
)
def test_odd_tags_are_found(tmp_path, tags, code):
    masks = [mask(k, np.repeat(tags, 120)[:, None] * np.ones((1, 320))) for k in range(3)]
    found = findings_of(log_with(tmp_path / "in.mcap", *masks))
    assert found.keys() == ({code} if code else set())
    if code == "tags":
        assert all(word in found[code] for word in ("24", "50 %", TABLE.name, "tag_table"))


def test_info_prints_findings_as_text_and_json(tmp_path, capsys):
    source = log_with(tmp_path / "in.mcap", edges(("odom", "base_link")))
    assert info_main([str(source)]) == 0
    assert "no transform leads" in " ".join(capsys.readouterr().out.split())
    assert info_main(["--json", str(source)]) == 0
    (found,) = json.loads(capsys.readouterr().out)["replay"]["findings"]
    assert found["code"] == "camera_transform"


def test_convert_prints_findings_as_notes(data_dir, tmp_path, capsys):
    assert convert_main([str(data_dir / "carla_rgbd"), str(tmp_path / "in.mcap"), "--fov", "1.2"]) == 0
    said = capsys.readouterr().out
    assert "note: field_of_view: camera_front: fx" in said
    assert "--fov DEGREES" in said


def test_the_sample_has_no_finding():
    assert findings_of(SAMPLE) == {}


HEALTHY = (
    "carla_frame",
    "carla_leaderboard/route_00",
    "carla_raw_tags",
    "course_frames",
    "course_stereo",
    "highway_second/test_video.mp4",
    "kitti_object",
    "kitti_tracking",
    "nuscenes_sample",
    "stop_and_go",
)


@pytest.mark.parametrize("name", HEALTHY)
def test_healthy_recordings_have_no_finding(data_dir, tmp_path, name):
    assert convert_main([str(data_dir / name), str(tmp_path / "in.mcap"), "--quiet"]) == 0
    assert findings_of(tmp_path / "in.mcap") == {}


@pytest.mark.long
@pytest.mark.parametrize("name", [*HEALTHY, "carla_rgbd", "kitti_odometry"])
def test_replays_of_healthy_recordings_have_no_finding(data_dir, tmp_path, name):
    assert convert_main([str(data_dir / name), str(tmp_path / "in.mcap"), "--quiet"]) == 0
    require_no_finding(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "options"),
    [
        ("straight", "--without depth --without right --fov 70"),
        ("bend", "--without depth"),
        ("town", ""),
        ("town", "--without depth --without right --fov 70"),
        ("hill", "--lidar"),
    ],
)
def test_replays_of_rendered_drives_have_no_finding(tmp_path, scene, options):
    seed = str(len(scene) + len(options))
    small = "--size 320x240 --seconds 2 --rate 10"
    assert (
        render_main([str(tmp_path / "dump"), "--scene", scene, "--seed", seed, *small.split(), *options.split()]) == 0
    )
    assert convert_main([str(tmp_path / "dump"), str(tmp_path / "in.mcap"), "--quiet"]) == 0
    require_no_finding(tmp_path)


def require_no_finding(folder):
    assert replay(folder / "in.mcap", folder / "out.mcap").findings == ()
