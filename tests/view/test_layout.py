"""Layouts for Foxglove and Lichtblick show the topics of a log."""

import json
import random
import re
from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap_protobuf.schema import build_file_descriptor_set

from roadperc_stream import log
from roadperc_stream.config import load_config
from roadperc_stream.errors import ChannelError, TargetError
from roadperc_stream.log import Channel, Message
from roadperc_stream.schemas import roadperc_pb2
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.schemas.topics import LIVE_ONLY, METRICS_TOPIC, ON_REQUEST, RESULTS, TIMES_TOPIC, result_schemas
from roadperc_stream.view.layout.contents import OF_A_LIVE_REPLAY, LogContents, contents_of
from roadperc_stream.view.layout.filling import layout_of, write_layout
from tests import logs
from tests.replaying import replay

SCHEMAS = {role.topic: role.schema for role in ROLES.values()} | result_schemas(["overlay", "debug"]) | LIVE_ONLY
EVERYTHING = replace(OF_A_LIVE_REPLAY, results=OF_A_LIVE_REPLAY.results | set(ON_REQUEST))


def laid_out(has):
    return json.loads(layout_of(has))


def panels_of(layout, kind):
    return {key: config for key, config in layout["configById"].items() if key.startswith(f"{kind}!")}


def arranged(layout, node):
    """Keys of the panels in a part of the arrangement, including those in tabs."""
    if isinstance(node, dict):
        assert node.keys() == {"direction", "first", "second", "splitPercentage"}
        assert node["direction"] in {"row", "column"}
        assert 0 < node["splitPercentage"] < 100
        return [*arranged(layout, node["first"]), *arranged(layout, node["second"])]
    parts = layout["configById"][node].get("tabs", ())
    return [node, *(key for tab in parts for key in arranged(layout, tab["layout"]))]


def shown(layout):
    """Each topic, or topic and column, that a panel shows."""
    found = set()
    for config in panels_of(layout, "Image").values():
        found |= {config["imageMode"]["imageTopic"], *config["imageMode"].get("annotations", ())}
    for config in panels_of(layout, "3D").values():
        found |= set(config["topics"])
    for config in [*panels_of(layout, "Plot").values(), *panels_of(layout, "StateTransitions").values()]:
        found |= {path["value"] for path in config["paths"]}
    found |= {config["topicToRender"] for config in panels_of(layout, "RosOut").values()}
    found |= {config["topicPath"] for config in panels_of(layout, "RawMessages").values()}
    for name, script in layout["userNodes"].items():
        assert layout["configById"][f"Table!{name}"]["topicPath"] == f"/studio_script/{name}.rows"
        assert f'export const output = "/studio_script/{name}";' in script["sourceCode"]
        found.add(re.search(r'^export const inputs = \["(.+)"\];$', script["sourceCode"], re.M)[1])
    return found


def topics_shown(layout):
    return {path.partition(".")[0] for path in shown(layout)}


def check(layout, topics):
    """The layout has the form that both viewers read, and every panel shows one of ``topics``."""
    assert layout.keys() - {"layout"} == {"configById", "globalVariables", "userNodes", "playbackConfig"}
    root = layout.get("layout")
    assert sorted(arranged(layout, root) if root else []) == sorted(layout["configById"])
    for config in panels_of(layout, "Tab").values():
        assert len(config["tabs"]) > 1
        assert len({tab["title"] for tab in config["tabs"]}) == len(config["tabs"])
    assert all(config["paths"] for kind in ("Plot", "StateTransitions") for config in panels_of(layout, kind).values())
    assert all(config["topics"] for config in panels_of(layout, "3D").values())
    assert topics_shown(layout) <= set(topics)


def some_contents(seed):
    """Random contents of a log."""
    pick = random.Random(seed)
    share = pick.choice((0.1, 0.5, 0.9))

    def some(items):
        return [item for item in sorted(items) if pick.random() < share]

    results = frozenset(some(EVERYTHING.results))
    return LogContents(
        roles={role: ROLES[role].topic for role in some(ROLES)},
        results=results,
        columns=frozenset(some(EVERYTHING.columns)) if METRICS_TOPIC in results else frozenset(),
        more_images=tuple(some(["/rear/image", "/side/image"])),
        has_ego_frame=pick.random() < share,
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_layout_has_panels_for_the_topics_of_the_log(seed):
    has = some_contents(seed)
    layout = laid_out(has)
    check(layout, {*has.roles.values(), *has.results, *has.more_images})
    assert (has.results & set(ON_REQUEST)) | set(has.more_images) <= topics_shown(layout)


def test_a_log_with_all_topics_has_panels_for_all():
    layout = laid_out(EVERYTHING)
    check(layout, SCHEMAS)
    assert set(RESULTS) | set(ON_REQUEST) | set(LIVE_ONLY) <= topics_shown(layout)
    truths = {"/truth/lanes", "/truth/surface", "/truth/objects", "/truth/pose"}  # in the metrics, as errors
    unshown = {*truths, "/camera/front/detections", "/tf_static"} | {t for t in SCHEMAS if t.endswith("calibration")}
    assert set(SCHEMAS) - topics_shown(layout) <= unshown


def test_a_layout_without_contents_has_no_panels():
    assert laid_out(LogContents(roles={})) == {
        "configById": {},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
    }


def paths_of(layout):
    return {path for path in shown(layout) if "." in path}


def test_plotted_paths_are_fields_of_their_messages():
    for path in paths_of(laid_out(EVERYTHING)):
        topic, _, name = path.partition(".")
        assert name in MESSAGE_TYPES[SCHEMAS[topic]].DESCRIPTOR.fields_by_name, path


def test_stage_times_are_plotted_only_if_they_are_served():
    times = [path.partition(".")[2] for path in paths_of(laid_out(EVERYTHING)) if path.startswith(TIMES_TOPIC)]
    assert sorted(times) == sorted(TIME_COLUMNS)
    without = replace(EVERYTHING, results=EVERYTHING.results - {TIMES_TOPIC})
    assert TIMES_TOPIC not in topics_shown(laid_out(without))
    no_stereo = replace(EVERYTHING, results=EVERYTHING.results - {"/perception/stereo/depth"})
    assert f"{TIMES_TOPIC}.stereo_ms" not in paths_of(laid_out(no_stereo))


def test_the_objects_table_reads_fields_and_states_of_the_message():
    (script,) = laid_out(EVERYTHING)["userNodes"].values()
    statuses = json.loads(re.search(r"statuses: .* = (\{.*\});", script["sourceCode"])[1])
    known = roadperc_pb2.Object.Status.items()
    assert statuses == {str(number): name.lower() for name, number in known if number}
    read = set(re.findall(r"seen\.(\w+)", script["sourceCode"]))
    assert read <= set(roadperc_pb2.Object.DESCRIPTOR.fields_by_name)


def test_the_scene_follows_the_ego_frame_if_the_log_has_it():
    (scene,) = panels_of(laid_out(EVERYTHING), "3D").values()
    assert scene["followTf"] == "ego"
    (scene,) = panels_of(laid_out(LogContents(roles={"tf": "/tf"})), "3D").values()
    assert "followTf" not in scene


def test_titles_of_tabs_name_the_shown_panels():
    tabs = laid_out(LogContents(roles={"depth": "/d", "truth_depth": "/t"}))["configById"]["Tab!pictures"]["tabs"]
    assert [(tab["title"], tab["layout"]) for tab in tabs] == [
        ("Depth", "Image!depth"),
        ("True depth", "Image!truth_depth"),
    ]


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """A short input and three results: plain, with all pictures, and without the input."""
    folder = tmp_path_factory.mktemp("replayed")
    source = logs.write(folder / "in.mcap", logs.items(frames=3))
    replay(source, folder / "out.mcap", load_config(None, ()))
    replay(source, folder / "full.mcap", load_config(None, ()), on_request=("overlay", "debug"))
    replay(source, folder / "results.mcap", load_config(None, ()), results_only=True)
    return folder


@pytest.mark.parametrize("name", ["in", "out", "full", "results"])
def test_a_layout_shows_only_topics_with_messages(replayed, name):
    path = replayed / f"{name}.mcap"
    write_layout(path.with_suffix(".json"), path, force=True)
    layout = json.loads(path.with_suffix(".json").read_text("utf-8"))
    summary = log.summarise(path)
    topics = {c.topic for c in summary.channels if summary.counts.get(c.source_id)}
    check(layout, topics)
    assert {topic for topic in topics if topic.startswith("/perception/")} <= topics_shown(layout)
    assert ("/perception/overlay" in topics_shown(layout)) is (name == "full")
    front, drawn = layout["configById"]["Image!front"], "" if name == "in" else ": lanes and objects"
    topic, title = (
        ("/perception/drivable", "Drivable") if name == "results" else ("/camera/front/image", "Front camera")
    )
    assert (front["imageMode"]["imageTopic"], front["foxglovePanelTitle"]) == (topic, title + drawn)


def test_metrics_without_a_value_are_not_plotted(replayed):
    has = contents_of(replayed / "out.mcap", {})
    assert "lane_left_offset_m" in has.columns
    assert "lane_left_error_m" not in has.columns  # this log carries no truth
    assert "Plot!left_error" not in laid_out(has)["configById"]


def elsewhere(path, **topics):
    """A log with other topic names for some roles."""
    items = [logs.Item(i.role, i.stamp_ns, i.data, topics.get(i.role, "")) for i in logs.items(frames=1)]
    return logs.write(path, items)


def test_topics_with_other_names_are_shown(tmp_path):
    source = elsewhere(tmp_path / "in.mcap", image="/a/rgb", calibration="/a/info", segmentation="/a/seg", depth="/a/d")
    target = tmp_path / "layout.json"
    write_layout(target, source, {"depth": "/a/d"}, force=False)
    panels = json.loads(target.read_text("utf-8"))["configById"]
    assert panels["Image!front"]["imageMode"]["imageTopic"] == "/a/rgb"
    assert panels["Image!tags"]["imageMode"]["imageTopic"] == "/a/seg"
    assert panels["Image!depth"]["imageMode"]["imageTopic"] == "/a/d"
    assert {"/a/info", "/tf"} == set(panels["3D!scene"]["topics"])


def test_images_without_a_role_get_tabs(tmp_path):
    items = logs.items(frames=1)
    rear = [logs.Item(i.role, i.stamp_ns, i.data, "/rear/rgb") for i in items if i.role == "image"]
    has = contents_of(logs.write(tmp_path / "in.mcap", [*items, *rear]), {})
    assert has.more_images == ("/rear/rgb",)
    titles = [tab["title"] for tab in laid_out(has)["configById"]["Tab!front"]["tabs"]]
    assert titles == ["Camera", "/rear/rgb"]


@pytest.mark.parametrize(("encoding", "dtype", "most"), [("32FC1", "<f4", 60), ("16UC1", "<u2", 60_000)])
def test_depth_is_coloured_in_the_unit_of_the_log(tmp_path, encoding, dtype, most):
    """Viewers colour the raw numbers: metres as floats, millimetres as integers."""
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


def test_the_left_camera_replaces_a_missing_front_camera(tmp_path):
    items = logs.items(frames=1, roles=("calibration", "image"))
    left = {"image": "left", "calibration": "left_calibration"}
    source = logs.write(tmp_path / "in.mcap", [logs.Item(left[i.role], i.stamp_ns, i.data) for i in items])
    pictures = panels_of(laid_out(contents_of(source, {})), "Image")
    assert [p["imageMode"]["imageTopic"] for p in pictures.values()] == ["/camera/left/image"]


def test_a_failed_layout_names_the_log_and_writes_nothing(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=1))
    with pytest.raises(ChannelError, match=r"in\.mcap: --topic image=/none: no such topic"):
        write_layout(tmp_path / "layout.json", source, {"image": "/none"}, force=True)
    assert list(tmp_path.iterdir()) == [source]


def test_an_existing_layout_is_replaced_only_with_force(tmp_path):
    path = tmp_path / "layout.json"
    write_layout(path, force=False)
    assert path.read_text("utf-8") == layout_of(OF_A_LIVE_REPLAY)
    path.write_text("mine")
    with pytest.raises(TargetError, match="exists; pass --force"):
        write_layout(path, force=False)
    assert path.read_text() == "mine"
    write_layout(path, force=True)
    assert path.read_text("utf-8") == layout_of(OF_A_LIVE_REPLAY)
