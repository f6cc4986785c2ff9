"""The layout for Foxglove names what the log has, and leaves no result out."""

import json
import re

import numpy as np
import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap_protobuf.schema import build_file_descriptor_set

from roadperc_stream.errors import ChannelError, LogError, TargetError
from roadperc_stream.log import Channel, Message
from roadperc_stream.schemas import roadperc_pb2
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.schemas.topics import LIVE_ONLY, ON_REQUEST, RESULTS, result_schemas
from roadperc_stream.view.layout import foxglove_layout, topics_in, write_layout
from tests import logs

LAYOUT = json.loads(foxglove_layout())
PANELS = LAYOUT["configById"]
TOPICS = {role.topic: role.schema for role in ROLES.values()} | result_schemas(["overlay", "debug"]) | LIVE_ONLY
STEP = re.compile(r"\.(\w+)(\[:\])?")
IMAGES = {"foxglove.CompressedImage", "sensor_msgs/msg/Image"}


def strings(node):
    """All strings of a JSON document, keys among them."""
    if isinstance(node, dict):
        node = [*node, *node.values()]
    if isinstance(node, list):
        for child in node:
            yield from strings(child)
    elif isinstance(node, str):
        yield node


PATHS = sorted({text for text in strings(PANELS) if text.startswith("/")})


def topic_of(path):
    return path.partition(".")[0]


def arranged(node):
    """Panels of a part of the arrangement, those in tabs among them."""
    if isinstance(node, dict):
        return [*arranged(node["first"]), *arranged(node["second"])]
    tabs = PANELS[node].get("tabs", ())
    return [node, *(panel for tab in tabs for panel in arranged(tab["layout"]))]


def resolve(descriptor, steps):
    """The field that a path ends in; KeyError where a message has no such field. All of a list is said by ``[:]``."""
    *way, (last, _) = steps
    for name, every in way:
        field = descriptor.fields_by_name[name]
        assert field.is_repeated == bool(every), name
        descriptor = field.message_type
    return descriptor.fields_by_name[last]


def test_every_result_is_shown_and_nothing_else_is_named():
    shown = {topic_of(path) for path in PATHS}
    assert set(RESULTS) | set(ON_REQUEST) | set(LIVE_ONLY) <= shown
    assert shown <= set(TOPICS)


@pytest.mark.parametrize("path", [path for path in PATHS if "." in path])
def test_a_path_leads_to_a_field_of_its_message(path):
    topic = topic_of(path)
    steps = STEP.findall(path.removeprefix(topic))
    assert topic + "".join(f".{name}{every}" for name, every in steps) == path
    descriptor = roadperc_pb2.DESCRIPTOR.message_types_by_name[TOPICS[topic].removeprefix("roadperc.")]
    assert resolve(descriptor, steps) is not None


def test_the_time_of_each_stage_is_shown():
    shown = {path.partition(".")[2] for path in PATHS if topic_of(path) in LIVE_ONLY}
    assert shown == set(TIME_COLUMNS)


def test_the_arrangement_holds_each_panel_once():
    assert sorted(arranged(LAYOUT["layout"])) == sorted(PANELS)


def test_panels_draw_only_what_they_can():
    for name, panel in PANELS.items():
        if name.startswith("Image!"):
            mode = panel["imageMode"]
            assert TOPICS[mode["imageTopic"]] in IMAGES
            assert {TOPICS[topic] for topic in mode.get("annotations", ())} <= {"foxglove.ImageAnnotations"}
        if name.startswith(("Plot!", "StateTransitions!")):
            assert all("." in path["value"] for path in panel["paths"])


def test_what_a_scene_draws_is_switched_on_in_3d():
    scenes = {topic for topic, schema in RESULTS.items() if schema == "foxglove.SceneUpdate"}
    topics = PANELS["3D!scene"]["topics"]
    assert scenes <= {topic for topic, settings in topics.items() if settings["visible"]}


def test_the_camera_and_its_pictures_have_whole_tabs():
    tabs = {tab["title"]: tab["layout"] for tab in PANELS["Tab!front"]["tabs"]}
    assert tabs["Camera"] == "Image!front"
    shown = {PANELS[panel]["imageMode"]["imageTopic"] for panel in tabs.values()}
    assert set(ON_REQUEST) <= shown


def elsewhere(path, **topics):
    """A log whose roles are filled by topics of other names."""
    items = [logs.Item(i.role, i.stamp_ns, i.data, topics.get(i.role, "")) for i in logs.items(frames=1)]
    return logs.write(path, items)


def test_a_log_s_own_topics_stand_for_this_project_s(tmp_path):
    source = elsewhere(tmp_path / "in.mcap", image="/a/rgb", calibration="/a/info", segmentation="/a/seg", depth="/a/d")
    target = tmp_path / "layout.json"
    write_layout(target, source, {"depth": "/a/d"}, force=False)
    panels = json.loads(target.read_text("utf-8"))["configById"]
    front = panels["Image!front"]["imageMode"]
    assert (front["imageTopic"], front["calibrationTopic"]) == ("/a/rgb", "/a/info")
    assert front["annotations"] == PANELS["Image!front"]["imageMode"]["annotations"]
    assert panels["Image!tags"]["imageMode"]["imageTopic"] == "/a/seg"
    assert panels["Image!depth"]["imageMode"]["imageTopic"] == "/a/d"
    calibration = PANELS["3D!scene"]["topics"]["/camera/front/calibration"]
    assert panels["3D!scene"]["topics"]["/a/info"] == calibration
    assert "/camera/front/calibration" not in panels["3D!scene"]["topics"]


def test_a_log_of_this_project_s_topics_gets_the_file_as_shipped(tmp_path):
    source, target = logs.write(tmp_path / "in.mcap", logs.items(frames=1)), tmp_path / "layout.json"
    write_layout(target, source, force=False)
    assert json.loads(target.read_text("utf-8")) == LAYOUT


@pytest.mark.parametrize(("encoding", "dtype", "most"), [("32FC1", "<f4", 60), ("16UC1", "<u2", 60_000)])
def test_depth_is_coloured_in_the_unit_of_the_log(tmp_path, encoding, dtype, most):
    """Viewers colour the numbers as they stand: metres in floats, millimetres in whole numbers."""
    pixels = np.full((4, 6), 30 if encoding == "32FC1" else 30_000, dtype)
    message = RawImage(width=6, height=4, encoding=encoding, step=pixels.strides[0], data=pixels.tobytes())
    channel = Channel(
        "/depth", "protobuf", "foxglove.RawImage", "protobuf", build_file_descriptor_set(RawImage).SerializeToString()
    )
    depth = [Message(channel, 1, 1, k, data) for k, data in enumerate((b"broken", message.SerializeToString()))]
    source, target = logs.write(tmp_path / "in.mcap", [], extra=depth), tmp_path / "layout.json"
    write_layout(target, source, {"depth": "/depth"}, force=False)
    panel = json.loads(target.read_text("utf-8"))["configById"]["Image!depth"]["imageMode"]
    assert (panel["imageTopic"], panel["maxValue"]) == ("/depth", most)


def test_the_left_camera_stands_for_the_front_one_where_there_is_none(tmp_path):
    items = logs.items(frames=1, roles=("calibration", "image"))
    left = {"image": "left", "calibration": "left_calibration"}
    source = logs.write(tmp_path / "in.mcap", [logs.Item(left[i.role], i.stamp_ns, i.data) for i in items])
    topics = topics_in(source, {})
    assert topics["/camera/front/image"] == "/camera/left/image"
    assert topics["/camera/front/calibration"] == "/camera/left/calibration"


def test_a_topic_that_is_not_there_names_the_log(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=1))
    with pytest.raises(ChannelError, match=r"in\.mcap: --topic image=/none: no such topic"):
        write_layout(tmp_path / "layout.json", source, {"image": "/none"}, force=False)
    assert not (tmp_path / "layout.json").exists()


def test_a_layout_never_replaces_its_log(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=1))
    before = source.read_bytes()
    with pytest.raises(TargetError, match=r"in\.mcap: expected a name that ends in \.json"):
        write_layout(source, source, force=True)
    assert source.read_bytes() == before


def test_a_log_with_nothing_to_show_gets_no_layout(tmp_path):
    source = logs.write(tmp_path / "in.mcap", [], extra=[logs.foreign()])
    with pytest.raises(LogError, match=r"in\.mcap: nothing here that this project shows"):
        write_layout(tmp_path / "layout.json", source, force=False)
    assert not (tmp_path / "layout.json").exists()


def test_a_layout_is_written_and_replaced_only_when_told(tmp_path):
    path = tmp_path / "layout.json"
    write_layout(path, force=False)
    assert json.loads(path.read_text("utf-8")) == LAYOUT
    path.write_text("mine")
    with pytest.raises(TargetError, match="exists already"):
        write_layout(path, force=False)
    assert path.read_text() == "mine"
    write_layout(path, force=True)
    assert json.loads(path.read_text("utf-8")) == LAYOUT


def test_a_folder_is_no_file_for_a_layout(tmp_path):
    with pytest.raises(TargetError, match="is a folder"):
        write_layout(tmp_path, force=True)
