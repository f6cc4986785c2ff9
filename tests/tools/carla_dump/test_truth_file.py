import numpy as np
import pytest

from roadperc_stream.errors import DumpError
from roadperc_stream.model import Box
from roadperc_stream.tools.carla_dump.truth_file import load_truth
from tests.tools.dump_writer import document

SIDE = {"offset_m": 1.7, "heading": 0.01, "curvature_per_m": 0.002, "inside": "road", "outside": "sidewalk"}
GRID = {"x_min_m": 0.0, "y_min_m": -1.0, "step_m": 0.5, "columns": 3, "rows": 2, "z_m": [0, 1, 2, 3, 4, 5]}
SURFACE = {
    "normal": [0.0, -2.0, 0.0],
    "camera_height_m": 1.4,
    "pitch": 0.01,
    "roll": -0.02,
    "a": 0.1,
    "b": -0.2,
    "d": 0.3,
    "height_grid": GRID,
}
OBJECT = {"id": 7, "label": "Car", "box_px": [1, 2, 3, 4], "distance_m": 12.5, "closing_speed_mps": None}
TRUTH = {
    "lanes": {"000003": {"left": {**SIDE, "line_ego_m": [[0, 1.7, 0], [1, 1.71, 0]]}, "right": None}},
    "surface": {"000003": SURFACE},
    "objects": {"000003": [OBJECT]},
}


def test_truth_by_frame(tmp_path):
    truth = load_truth(document(tmp_path / "truth.json", TRUTH), "camera_depth")
    (left,) = truth.lanes[3].boundaries
    assert (left.side, left.status, left.offset_m, left.outside) == ("left", "measured", 1.7, "sidewalk")
    np.testing.assert_array_equal(left.line_ego_m, [[0, 1.7, 0], [1, 1.71, 0]])
    surface = truth.surfaces[3]
    assert (surface.source, surface.frame_id, surface.camera_height_m) == ("truth", "camera_depth", 1.4)
    assert surface.plane.normal == (0.0, -1.0, 0.0)
    assert surface.plane.offset_m == 1.4
    np.testing.assert_allclose(surface.abd, (0.1, -0.2, 0.3))
    assert surface.height_grid is not None
    np.testing.assert_array_equal(surface.height_grid.z_m, [[0, 1, 2], [3, 4, 5]])
    (item,) = truth.objects[3].objects
    assert (item.kept, item.track_id, item.distance_m, item.closing_speed_mps) == (True, "7", 12.5, None)
    assert item.detection.box_px == Box(1, 2, 3, 4)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"lanes": {"0": {"left": {"offset_m": 1.0}}}}, r"lanes\.0\.left\.heading: Field required"),
        ({"surface": {"0": {**SURFACE, "camera_height_m": 0}}}, r"surface\.0\.camera_height_m"),
        ({"surface": {"0": {**SURFACE, "normal": [0, 0, 0]}}}, "surface of frame 0: normal is zero"),
        ({"surface": {"0": {**SURFACE, "height_grid": {**GRID, "rows": 3}}}}, "6 heights for 3 rows x 3 columns"),
        ({"objects": {"0": [{**OBJECT, "box_px": [3, 2, 1, 4]}]}}, "objects of frame 0: box"),
        ({"objects": {"0": [{**OBJECT, "distance_m": float("inf")}]}}, r"objects\.0\.0\.distance_m"),
    ],
)
def test_faults_name_file_and_key(tmp_path, change, fault):
    with pytest.raises(DumpError, match=fault) as caught:
        load_truth(document(tmp_path / "truth.json", change), "camera_front")
    assert "truth.json" in str(caught.value)
