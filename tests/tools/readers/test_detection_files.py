import pytest

from roadperc_stream.errors import DumpError
from roadperc_stream.model import Box, Detection
from roadperc_stream.tools.readers.detection_files import load_detections, load_labels
from tests.tools.dump_writer import document


def test_boxes_by_frame_keep_what_lies_outside_the_image(tmp_path):
    entry = {"label": "Car", "box_px": [-20.5, 4, 2532, 9], "score": 0.5, "corner_depth_m": [1], "id": 3}
    path = document(tmp_path / "detections.json", {"142916": [entry], "frame_7": []})
    detections, kind, notes = load_detections(path)
    assert detections == {142916: (Detection("Car", Box(-20.5, 4.0, 2532.0, 9.0), 0.5, "3"),), 7: ()}
    assert kind == "boxes by frame"
    assert notes == ()


def test_coco_results_with_standard_categories(tmp_path):
    """Of https://cocodataset.org's 91 categories those between person (1) and stop sign (13) that a road holds."""
    known = {1: "person", 2: "bicycle", 3: "car", 4: "motorcycle", 6: "bus", 7: "train", 8: "truck",
             10: "traffic light", 13: "stop sign"}  # fmt: skip
    box = {"bbox": [10, 20, 30, 40], "score": 0.5}
    entries = [{"image_id": "frame_0007", "category_id": number, **box} for number in range(1, 15)]
    entries.append({"image_id": 8, "label": "Van", **box})
    detections, kind, notes = load_detections(document(tmp_path / "detections.json", entries))
    assert kind == "COCO"
    assert [d.label for d in detections[7]] == [known.get(number, f"coco_{number}") for number in range(1, 15)]
    assert detections[8] == (Detection("Van", Box(10, 20, 40, 60), 0.5),)
    assert notes == ("COCO categories without a name: 5, 9, 11, 12, 14",)


def test_coco_annotations_with_images_and_categories(tmp_path):
    data = {
        "images": [{"id": 100, "file_name": "rgb/000004.png"}, {"id": 101, "file_name": "rgb/000005.png"}],
        "categories": [{"id": 1, "name": "Vehicle", "supercategory": "thing"}],
        "annotations": [{"id": 9, "image_id": 100, "category_id": 1, "bbox": [1, 2, 3, 4]}],
    }
    detections, _, notes = load_detections(document(tmp_path / "coco.json", data))
    assert detections == {4: (Detection("Vehicle", Box(1, 2, 4, 6), 1.0, "9"),), 5: ()}
    assert notes == ()


KITTI = """\
Car 0.00 0 -1.57 10.00 20.00 29.00 39.00 1.5 1.6 3.9 1.0 1.6 20.0 -1.6 0.75
DontCare -1 -1 -10 5.0 6.0 7.0 8.0 -1 -1 -1 -1000 -1000 -1000 -10

Pedestrian 0.00 0 -1.57 0.00 0.00 9.00 9.00 1.5 1.6 3.9 1.0 1.6 20.0 -1.6
"""


def test_kitti_maxima_become_half_open(tmp_path):
    path = tmp_path / "000003.txt"
    path.write_text(KITTI)
    car, person = Detection("Car", Box(10, 20, 30, 40), 0.75), Detection("Pedestrian", Box(0, 0, 10, 10), 1.0)
    assert load_labels({3: path}, [3, 4], (640, 480)) == ({3: (car, person)}, "KITTI labels")


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ({"0": [{"label": "Car", "box_px": [1, 2, 3]}]}, r"0\[0\]\.box_px\[3\]: missing"),
        ({"0": [{"label": "Car", "box_px": [9, 2, 3, 4]}]}, "frame 0: box 9.0, 2.0, 3.0, 4.0"),
        ({"0": [{"box_px": [1, 2, 3, 4]}]}, r"0\[0\]\.label: missing"),
        ({"1": [], "01": []}, "'1' and '01' are both frame 1"),
        ([{"image_id": 1, "bbox": [1, 2, 3, 4]}], "expected category_id, category or label"),
        ([{"image_id": "first", "bbox": [1, 2, 3, 4], "category_id": 3}], "'first': expected a frame number"),
        ([{"label": "Car", "box_px": [1, 2, 3, 4]}], r"\[0\]\.image_id: missing.*COCO"),
    ],
)
def test_faults_name_file_and_key(tmp_path, content, fault):
    with pytest.raises(DumpError, match=fault) as caught:
        load_detections(document(tmp_path / "detections.json", content))
    assert "detections.json" in str(caught.value)


@pytest.mark.parametrize(
    ("names", "content", "label"),
    [
        ("data.yaml", "names: [person, car]", "car"),
        ("data.yaml", "names:\n  0: person\n  1: car", "car"),
        ("labels/classes.txt", "person\ncar\n", "car"),
        ("classes.txt", "person\n", "1"),
        ("other.txt", "person\ncar", "1"),
    ],
)
def test_labels_of_yolo_are_boxes_in_pixels_with_the_names_of_the_classes(tmp_path, names, content, label):
    (tmp_path / "labels").mkdir()
    (tmp_path / names).write_text(content)
    path = tmp_path / "labels" / "7.txt"
    path.write_text("1 0.5 0.5 0.25 0.5 0.75\n")
    found, _ = load_labels({7: path}, [7, 8], (640, 480))
    assert found == {7: (Detection(label, Box(240.0, 120.0, 400.0, 360.0), 0.75),), 8: ()}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("0 0.5 0.5 0.1", "class"),
        ("0 320 240 64 48", "class"),
        ("0 0.1 0.1 0.1 0.2 0.2 0.2", "class"),
        ("0 nan 0 0 0", "finite numbers"),
        (f"{'9' * 6000} 0 0 0 0", "class"),
    ],
)
def test_a_line_that_is_no_box_of_yolo_is_named(tmp_path, line, expected):
    path = tmp_path / "0.txt"
    path.write_text(f"0 0.5 0.5 0.1 0.1\n{line}\n")
    with pytest.raises(DumpError, match=rf"0\.txt: line 2: expected ({expected})"):
        load_labels({0: path}, [0], (640, 480))


@pytest.mark.parametrize("line", ["Car 1 2 3", "Car 0 0 0 a 2 3 4 0 0 0 0 0 0 0", "Car 0 0 0 nan 2 3 4 0 0 0 0 0 0 0"])
def test_kitti_faults_name_the_line(tmp_path, line):
    path = tmp_path / "000003.txt"
    path.write_text(f"\n{line}\n")
    with pytest.raises(DumpError, match=r"000003\.txt: line 2: "):
        load_labels({3: path}, [3], (640, 480))


def test_a_file_without_names_of_classes_is_an_error(tmp_path):
    (tmp_path / "data.yaml").write_text("names: 3")
    path = tmp_path / "0.txt"
    path.write_text("0 0.5 0.5 0.1 0.1\n")
    with pytest.raises(DumpError, match=r"data\.yaml: expected names"):
        load_labels({0: path}, [0], (640, 480))
