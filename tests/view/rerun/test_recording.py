"""A recording, read back, has the entities, archetypes, timelines and values of the log."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.errors import LogError, TargetError
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.log import Channel, LogWriter
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14
from roadperc_stream.output.drawing.annotations import caption
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.record import PRODUCER
from roadperc_stream.schemas.row_messages import FrameMetrics
from roadperc_stream.schemas.topics import RESULTS
from roadperc_stream.view.rerun import save_recording
from roadperc_stream.view.rerun.blueprint import STAGE_COLOURS
from roadperc_stream.view.rerun.scene import metrics
from roadperc_stream.view.rerun.tree import SceneState
from tests import logs
from tests.analytic import STEP_NS
from tests.view.rerun.chunks import recorded
from tests.view.rerun.conftest import FRAMES

OF_EVERY_FRAME = {
    "/camera/front/image": "EncodedImage",
    "/camera/front/depth": "DepthImage",
    "/camera/front/segmentation": "SegmentationImage",
    "/camera/right/image": "EncodedImage",
    "/perception/drivable": "SegmentationImage",
    "/perception/drivable/scene/drivable": "LineStrips3D",
    "/perception/lanes/annotations/proposals": "LineStrips2D",
    "/perception/lanes/annotations/raw": "LineStrips2D",
    "/perception/lanes/annotations/smoothed": "LineStrips2D",
    "/perception/lanes/scene": "LineStrips3D",
    "/perception/metrics/lane_left_offset_m": "Scalars",
    "/perception/metrics/lane_left_status": "StateChange",
    "/perception/objects/annotations/dropped": "Boxes2D",
    "/perception/objects/annotations/kept": "Boxes2D",
    "/perception/objects/scene": "Boxes3D",
    "/perception/occupancy": "GridMap",
    "/perception/odometry": "Arrows3D",
    "/perception/stereo/depth": "DepthImage",
    "/perception/surface": "Mesh3D",
    "/perception/tf/ego": "Transform3D",
    "/perception/times/total_ms": "Scalars",
    "/perception/trajectory": "LineStrips3D",
}


def messages(path, topic):
    return list(log.read(log.summarise(path), topics=[topic]))


def decoded(path, kind, topic):
    for message in messages(path, topic):
        schema = message.channel.schema_name
        yield decode(kind, schema, "protobuf", message.data, message.log_time_ns, Context()).payload


@pytest.mark.parametrize("entity", OF_EVERY_FRAME)
def test_entities_have_a_row_for_every_frame(saved, entity):
    found = saved[entity]
    assert OF_EVERY_FRAME[entity] in found.archetypes
    assert [row["frame"] for row in found.rows] == list(range(FRAMES))


def test_timelines_are_log_time_and_frame(saved, output):
    times = [message.log_time_ns for message in messages(output, "/camera/front/image")]
    rows = saved["/camera/front/image"].rows
    assert [row["message_log_time"] for row in rows] == times
    assert "log_time" not in rows[0]


def test_images_keep_the_bytes_of_the_log(saved, output):
    blobs = [cell[0] for cell in saved["/camera/front/image"].column("EncodedImage:blob")]
    assert all(bytes(blob) in m.data for blob, m in zip(blobs, messages(output, "/camera/front/image"), strict=True))


def test_metrics_equal_those_of_the_log(saved, output):
    seen = [cell[0] for cell in saved["/perception/metrics/lane_left_offset_m"].column("Scalars:scalars")]
    rows = [FrameMetrics.FromString(message.data) for message in messages(output, "/perception/metrics")]
    assert seen == [row.lane_left_offset_m for row in rows]
    for name in ("lane_left_status", "nearest_object_class", "lane_left_boundary_class", "lane_right_boundary_class"):
        states = [state[0] for state in saved[f"/perception/metrics/{name}"].column("StateChange:state")]
        assert states == [getattr(row, name) for row in rows]
        assert any(states)
    assert not {"frame", "stamp_ns", "log_id"} & {entity.rpartition("/")[2] for entity in saved}


def test_stage_times_equal_those_of_the_table(saved, output):
    seen = [cell[0] for cell in saved["/perception/times/lanes_ms"].column("Scalars:scalars")]
    assert seen == pl.read_parquet(sidecar_path(output, "metrics"))["lanes_ms"].to_list()


def test_boxes_captions_and_classes_equal_those_of_the_log(saved, output):
    boxes = saved["/perception/objects/annotations/kept"]
    for k, objects in enumerate(decoded(output, "objects", "/perception/objects")):
        kept = [item for item in objects.objects if item.kept]
        corners = np.array(boxes.column("Boxes2D:centers")[k]) - np.array(boxes.column("Boxes2D:half_sizes")[k])
        wanted = [(item.detection.box_px.x_min, item.detection.box_px.y_min) for item in kept]
        assert corners == pytest.approx(np.array(wanted), abs=1e-3)
        assert boxes.column("Boxes2D:class_ids")[k] == [0] * len(kept)
        assert all(
            item.detection.label in text for item, text in zip(kept, boxes.column("Boxes2D:labels")[k], strict=True)
        )


def test_the_nearest_objects_have_captions_without_overlap(saved, output):
    names = saved["/perception/objects/annotations/captions"]
    for k, objects in enumerate(decoded(output, "objects", "/perception/objects")):
        kept = [item for item in objects.objects if item.kept]
        nearest = min(kept, key=lambda item: item.distance_m or np.inf)
        texts, places = names.column("Points2D:labels")[k], np.array(names.column("Points2D:positions")[k])
        assert caption(nearest) in texts
        assert set(texts) <= {caption(item) for item in kept}
        assert len(texts) < len(kept)  # distant cars overlap in the image
        rows = np.abs(places[:, None, 1] - places[:, 1]) + 1e3 * np.eye(len(places))
        columns = np.abs(places[:, None, 0] - places[:, 0])
        assert ((rows > 8) | (columns > 20)).all()  # a line of text is 8 of 270 pixels high


def test_kept_objects_are_at_their_distance(saved, output):
    centres = saved["/perception/objects/scene"].column("Boxes3D:centers")
    for k, objects in enumerate(decoded(output, "objects", "/perception/objects")):
        distances = [item.distance_m for item in objects.objects if item.kept and item.distance_m]
        assert np.linalg.norm(centres[k], axis=1) == pytest.approx(distances, rel=1e-5)


def test_lanes_are_inside_the_image_and_on_the_road(saved, output):
    strips = saved["/perception/lanes/annotations/smoothed"].column("LineStrips2D:strips")
    road = saved["/perception/lanes/scene"].column("LineStrips3D:strips")
    for k, lanes in enumerate(decoded(output, "lanes", "/perception/lanes")):
        points = np.concatenate(strips[k])
        assert (points.min(axis=0) >= 0).all()
        assert (points.max(axis=0) <= (360, 270)).all()
        assert np.array(road[k][0]) == pytest.approx(lanes.boundaries[0].line_ego_m, abs=1e-4)


def test_annotation_contexts_have_class_names_and_colours(saved):
    classes = saved["/camera/front/segmentation"].static[0]["AnnotationContext:context"][0]
    infos = {entry["class_id"]: entry["class_description"]["info"] for entry in classes}
    assert {i: info["label"] for i, info in infos.items()} == dict(enumerate(CARLA_FROM_0_9_14.names))
    r, g, b = CARLA_FROM_0_9_14.colours[1]
    assert infos[1]["color"] == (r << 24) | (g << 16) | (b << 8) | 255
    boxes = saved["/perception/objects"].static[0]["AnnotationContext:context"][0]
    assert [entry["class_description"]["info"]["label"] for entry in boxes][:3] == ["kept", "unverified", "dropped"]


def test_depth_is_metric_and_saturated_depth_is_unknown(saved):
    rows = saved["/camera/front/depth"].rows
    depth = np.frombuffer(bytes(rows[0]["DepthImage:buffer"][0]), np.uint16).reshape(270, 360)
    assert rows[0]["DepthImage:meter"] == [1000.0]
    assert depth[-1].mean() == pytest.approx(depth[-1, 0], rel=0.5)
    assert depth.max() < 65535
    assert (depth[:20] == 0).mean() > 0.3  # the sky


def test_an_input_log_is_shown(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=3))
    assert save_recording(source, tmp_path / "in.rrd", {}).frames == 3
    entities = recorded(tmp_path / "in.rrd")
    image, boxes = entities["/camera/front/image"].rows, entities["/camera/front/detections"]
    assert [row["frame"] for row in image] == [0, 1, 2]
    assert {row["CoordinateFrame:frame"][0] for row in image} == {"camera_image_plane"}
    assert boxes.column("Boxes2D:labels")[0] == ["Car 0.90", "Pedestrian 0.90"]
    assert not [entity for entity in entities if entity.startswith("/perception")]


@pytest.fixture(scope="module")
def without_second_detections(tmp_path_factory):
    """Three frames without stereo; the second one has no detections."""
    folder = tmp_path_factory.mktemp("missing")
    second = logs.START_NS + STEP_NS
    items = [i for i in logs.items(frames=3) if not (i.role == "detections" and i.stamp_ns == second)]
    source = logs.write(folder / "in.mcap", items)
    assert replay_main([str(source), str(folder / "out.mcap"), "--quiet"]) == 0
    save_recording(folder / "out.mcap", folder / "out.rrd", {})
    rows = [FrameMetrics.FromString(message.data) for message in messages(folder / "out.mcap", "/perception/metrics")]
    return recorded(folder / "out.rrd"), rows


def test_results_missing_in_a_frame_are_cleared(without_second_detections):

    entity = without_second_detections[0]["/perception/objects/annotations/dropped"]
    rows = sorted(entity.rows, key=lambda row: row["frame"])
    assert [(row["frame"], row.get("Clear:is_recursive")) for row in rows] == [(0, None), (1, [False]), (2, None)]


def test_changed_reasons_are_log_lines(without_second_detections):
    entities = without_second_detections[0]
    lines = sorted(entities["/perception/metrics/reasons"].rows, key=lambda row: row["frame"])
    assert [row["frame"] for row in lines] == [0, 1, 2]
    assert "detections: no message at this frame" in lines[1]["TextLog:text"][0]
    assert "detections" not in lines[2]["TextLog:text"][0]


def test_missing_roles_are_a_state_that_ends(without_second_detections):
    states = sorted(without_second_detections[0]["/perception/metrics/missing"].rows, key=lambda row: row["frame"])
    assert [(row["frame"], row["StateChange:state"]) for row in states] == [(1, ["detections"]), (2, [""])]


NO_RIGHT = ({"source": "stereo", "code": "no_right_image"},)


def test_reasons_and_their_end_are_drawn_once():
    state, drawn = SceneState(), []
    for reasons in ((), NO_RIGHT, NO_RIGHT, ()):
        entries = metrics("/perception/metrics", FrameMetrics(reasons=reasons), state)
        drawn.append([entry.archetype.text.as_arrow_array().to_pylist() for entry in entries])
    assert drawn == [[], [["stereo: no right image"]], [], [["nothing is missing now"]]]


def test_stage_times_of_another_replay_are_left_out(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=2))
    other = logs.write(tmp_path / "other.mcap", logs.items(frames=3))
    assert replay_main([str(source), str(tmp_path / "out.mcap"), "--quiet"]) == 0
    assert replay_main([str(other), str(tmp_path / "else.mcap"), "--quiet"]) == 0
    sidecar_path(tmp_path / "else.mcap", "metrics").replace(sidecar_path(tmp_path / "out.mcap", "metrics"))
    save_recording(tmp_path / "out.mcap", tmp_path / "out.rrd", {})
    assert not [e for e in recorded(tmp_path / "out.rrd") if e.startswith("/perception/times")]


NOTHING = "no topic that roadperc-view can show; "


@pytest.mark.parametrize(
    ("items", "extra", "why"),
    [
        ([], [], "the log has no messages to show$"),
        ([], [logs.foreign()], f"{NOTHING}try rerun "),
        (
            [logs.Item("lidar", 5, b"", "/front/points"), logs.Item("lidar", 5, b"", "/back/points")],
            [],
            f"{NOTHING}role lidar: not assigned; .* --topic lidar=/front/points; try rerun ",
        ),
        (
            [logs.Item("image", 5, b"\xff\xfe\x07bad")],
            [],
            f"{NOTHING}/camera/front/image: message at 5 ns: 6 bytes are not .*; try rerun .*in.mcap.* or ",
        ),
    ],
    ids=["no message", "nothing known", "a topic that could fill a role", "nothing that can be read"],
)
def test_a_log_without_shown_topics_gives_no_recording(tmp_path, items, extra, why):
    source = logs.write(tmp_path / "in.mcap", items, extra)
    with pytest.raises(LogError, match=rf"in\.mcap: {why}"):
        save_recording(source, tmp_path / "out.rrd", {})
    assert list(tmp_path.iterdir()) == [source]


def test_messages_without_a_frame_are_not_counted_as_frames(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=0))
    assert save_recording(source, tmp_path / "in.rrd", {}).frames == 0
    assert {"/camera/front/calibration", "/tf/camera"} <= set(recorded(tmp_path / "in.rrd"))


def test_a_damaged_log_gives_no_recording(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=2))
    content = bytearray(source.read_bytes())
    content[len(content) // 2] ^= 0xFF
    source.write_bytes(content)
    with pytest.raises(LogError, match=r"in\.mcap"):
        save_recording(source, tmp_path / "in.rrd", {})
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


def test_an_existing_recording_is_replaced_only_with_force(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=1))
    target = tmp_path / "in.rrd"
    target.write_text("mine")
    with pytest.raises(TargetError, match=r"in\.rrd: exists; pass --force to overwrite it"):
        save_recording(source, target, {})
    assert target.read_text() == "mine"
    save_recording(source, target, {}, force=True)
    assert "/camera/front/image" in recorded(target)


@pytest.fixture(scope="module")
def with_overlay(tmp_path_factory):
    folder = tmp_path_factory.mktemp("overlay")
    source = logs.write(folder / "in.mcap", logs.items(frames=2))
    assert replay_main([str(source), str(folder / "out.mcap"), "--quiet", "--overlay"]) == 0
    return folder / "out.mcap"


@pytest.mark.parametrize(
    "topic", ["/camera/front/image", "/camera/front/detections", "/perception/metrics", "/perception/overlay", "/tf"]
)
def test_damaged_messages_are_counted_and_the_others_drawn(with_overlay, tmp_path, topic):
    broken = tmp_path / "broken.mcap"
    with LogWriter(broken) as writer:
        for message in log.read(log.summarise(with_overlay)):
            hit = message.channel.topic == topic
            writer.write(replace(message, data=b"\xff\xfe\x07garbage") if hit else message)
    exported = save_recording(broken, tmp_path / "out.rrd", {})
    assert set(exported.problems) == {topic}
    assert any("message at" in note for note in exported.notes)
    assert "/perception/lanes/annotations/smoothed" in recorded(tmp_path / "out.rrd")


def test_foreign_topics_with_names_of_results_are_ignored(tmp_path):
    theirs = [Channel(topic, "cdr", "std_msgs/msg/String", "ros2msg", b"string data\n") for topic in RESULTS]
    ours = [replace(channel, metadata=(PRODUCER,)) for channel in theirs]
    source, foreign = logs.write(tmp_path / "in.mcap", logs.items(frames=2)), tmp_path / "foreign.mcap"
    for channels in (theirs, ours):
        with LogWriter(foreign) as writer:
            for message in log.read(log.summarise(source)):
                writer.write(message)
                for channel in channels:
                    writer.write(replace(message, channel=channel, data=b"\0\1\0\0\2\0\0\0x\0"))
        exported = save_recording(foreign, tmp_path / "out.rrd", {}, force=True)
        assert (exported.frames, exported.problems) == (2, {})


def test_every_stage_has_its_own_colour():
    assert {f"{stage}_ms" for stage in STAGE_COLOURS} == set(TIME_COLUMNS)
    assert len(set(STAGE_COLOURS.values())) == len(TIME_COLUMNS)
