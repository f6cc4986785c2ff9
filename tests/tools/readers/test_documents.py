import contextlib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roadperc_stream.errors import DumpError
from roadperc_stream.tools.readers.calibration_file import load_calibration
from roadperc_stream.tools.readers.detection_files import load_detections
from roadperc_stream.tools.readers.documents import EPOCH_NS, by_frame, frame_number
from roadperc_stream.tools.readers.truth_file import load_poses, load_truth
from tests.tools.dump_writer import document

WORDS = """
0 1 01 frame label box_px score bbox image_id category_id categories annotations images id name file_name
K width height fov_deg mounting rgb x y z location rotation pitch yaw roll P_left P_right lanes left surface normal
"""
KEYS = st.sampled_from(WORDS.split())
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("frame_00001", 1),
        ("142916", 142916),
        ("000084", 84),
        ("a1_b2_c", 2),
        ("left", None),
        ("", None),
        ("1305031102.933", 1_305_031_102_933_000_000),
        ("rgb_1305031102.000000001", 1_305_031_102_000_000_001),
        ("v1.2_1305031102", 1_305_031_102),
        ("130503110.933", 933),
        ("12.80", EPOCH_NS + 12_800_000_000),
        ("rgb_0013.050", EPOCH_NS + 13_050_000_000),
        ("12.850000000000001", EPOCH_NS + 12_850_000_000),
        ("shot1.0001", 1),
        ("0.9.15", 15),
        ("frankfurt_000000_000294_leftImg8bit", 294),
        ("frankfurt_000000_000294_gtFine_labelIds", 294),
    ],
)
def test_the_last_group_of_digits_is_the_frame(name, number):
    assert frame_number(name) == number


@given(st.dictionaries(st.integers(0, 10**6), st.integers()))
def test_zeros_in_front_do_not_matter(entries):
    assert by_frame("x.json", {f"{number:08d}": entry for number, entry in entries.items()}) == entries


@pytest.mark.parametrize(
    "load",
    [load_calibration, load_detections, load_poses, lambda path: load_truth(path, "camera_front")],
    ids=["calibration", "detections", "poses", "truth"],
)
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=VALUES)
def test_any_document_is_read_or_stated(tmp_path, load, content):
    path = document(tmp_path / "document.json", content)
    with contextlib.suppress(DumpError):
        load(path)
