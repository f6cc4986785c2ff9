from pathlib import Path

import numpy as np
import pytest

from roadperc_stream.config.calibration import CalibrationConfig
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import EGO_R_OPTICAL
from roadperc_stream.tools.rig import build_rig

PATH = Path("dump/calibration.json")
SIZE = (1280, 960)
BASE = {"width": 1280, "height": 960, "fov_deg": 90}
RGB = {"x": 1.5, "y": 0.0, "z": 1.4}


def rig(roles=("image", "depth"), front_name="image", **content):
    calibration = CalibrationConfig.model_validate({**BASE, **content})
    return build_rig(calibration, PATH, roles, dict.fromkeys(roles, SIZE), front_name=front_name)


def edges(found):
    return {(edge.parent, edge.child): edge.parent_T_child for edge in found.transforms}


def test_without_a_mounting_there_are_no_transforms():
    found = rig()
    assert found.transforms == ()
    assert set(found.cameras) == {"calibration"}
    assert found.frame_ids["depth"] == "camera_front"


def test_a_depth_camera_mounted_elsewhere_has_its_own_frame():
    found = rig(rgb_height_m=1.7, depth_height_m=1.5)
    transforms = edges(found)
    assert set(transforms) == {("ego", "camera_front"), ("ego", "camera_depth")}
    np.testing.assert_allclose(transforms["ego", "camera_depth"][:3, 3], [0, 0, 1.5])
    np.testing.assert_allclose(transforms["ego", "camera_front"][:3, :3], EGO_R_OPTICAL)
    assert found.frame_ids["depth"] == "camera_depth"
    assert set(found.cameras) == {"calibration"}


def test_other_intrinsics_of_the_depth_camera_are_calibrated():
    found = rig(cameras={"depth": {"width": 640, "height": 480, "fov_deg": 90}})
    assert found.camera_of("depth").size == (480, 640)
    assert found.camera_of("truth_depth").fx == 320
    assert found.camera_of("segmentation").fx == 640


PAIR = ("image", "right")


@pytest.mark.parametrize(
    ("content", "edge", "place"),
    [
        ({"mounting": {"rgb": RGB, "right": {**RGB, "y": 0.5}}}, ("ego", "camera_right"), [1.5, -0.5, 1.4]),
        (
            {"mounting": {"rgb": {**RGB, "yaw": 90}}, "baseline_m": 0.5},
            ("ego", "camera_right"),
            [1.0, 0.0, 1.4],
        ),
        ({"baseline_m": 0.5}, ("camera_front", "camera_right"), [0.5, 0, 0]),
    ],
    ids=["mounted", "baseline and front mounting", "baseline alone"],
)
def test_the_right_camera_has_its_place_and_baseline(content, edge, place):
    found = rig(roles=PAIR, **content)
    assert found.cameras["right_calibration"].baseline_m == pytest.approx(0.5)
    np.testing.assert_allclose(edges(found)[edge][:3, 3], place, atol=1e-12)


def test_the_left_camera_as_front_takes_its_mounting():
    found = rig(roles=("image",), front_name="left", mounting={"left": {**RGB, "y": -0.25}, "rgb": RGB})
    np.testing.assert_allclose(edges(found)["ego", "camera_front"][:3, 3], [1.5, 0.25, 1.4])


def test_a_pair_without_a_baseline_is_noted():
    found = rig(roles=PAIR)
    assert found.cameras["right_calibration"].baseline_m is None
    assert "baseline unknown" in found.notes[0]


def test_unknown_names_and_a_shifted_segmentation_are_noted():
    notes = " ".join(rig(mounting={"rgb": RGB, "seg": {**RGB, "z": 1.0}, "radar": RGB}).notes)
    assert "'radar'" in notes
    assert "tags and image do not align" in notes


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ({"fov_deg": None}, "camera_front has no calibration.*--fov"),
        ({"mounting": {"rgb": RGB, "right": {**RGB, "y": 0.5}}, "baseline_m": 0.7}, "baseline 0.7 m, but .* 0.5 m"),
        ({"mounting": {"rgb": RGB, "right": {**RGB, "y": -0.5}}}, "is not to the right"),
        ({"mounting": {"rgb": RGB, "right": RGB}}, "is not to the right"),
    ],
)
def test_contradictions_are_errors(content, fault):
    with pytest.raises(DumpError, match=fault):
        rig(roles=PAIR, **content)


@pytest.mark.parametrize(("fy", "notes"), [(640, 0), (620, 0), (480, 1)])
def test_pixels_that_are_not_square_are_noted_once(fy, notes):
    found = rig(
        roles=("image", "depth", "right"), K=((640, 0, 640), (0, fy, 480), (0, 0, 1)), fov_deg=None, baseline_m=0.5
    )
    notes_found = [note for note in found.notes if "differ by more than 5 %" in note]
    assert len(notes_found) == notes
    assert all("fx 640 and fy 480 of calibration.json" in note for note in notes_found)


def test_a_depth_camera_with_the_same_mounting_shares_the_front_frame():
    found = rig(mounting={"rgb": RGB, "depth": RGB})
    assert set(edges(found)) == {("ego", "camera_front")}
    assert found.frame_ids["depth"] == "camera_front"


def test_without_depth_images_there_is_no_depth_frame():
    assert set(edges(rig(roles=("image",), rgb_height_m=1.7, depth_height_m=1.5))) == {("ego", "camera_front")}


def test_depth_alone_is_the_front_camera():
    found = rig(roles=("depth",), depth_height_m=1.5)
    np.testing.assert_allclose(edges(found)["ego", "camera_front"][:3, 3], [0, 0, 1.5])
    assert found.frame_ids["depth"] == "camera_front"


def test_a_left_camera_beside_the_front_one_is_the_pairs_base():
    mounting = {"rgb": RGB, "left": {**RGB, "y": -0.2}, "right": {**RGB, "y": 0.2}}
    found = rig(roles=("image", "left", "right"), mounting=mounting)
    assert found.cameras["right_calibration"].baseline_m == pytest.approx(0.4)
    assert {child for _, child in edges(found)} == {"camera_front", "camera_left", "camera_right"}


def test_an_unknown_size_is_an_error():
    with pytest.raises(DumpError, match="camera_front: its image size is unknown"):
        build_rig(CalibrationConfig.model_validate({"fov_deg": 90}), PATH, ("depth",), {})
