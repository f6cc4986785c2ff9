"""A log whose tags name no table: what the user of a replay says of them stays with its result."""

from dataclasses import replace

import cv2
import numpy as np
import polars as pl
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from roadperc_stream import log
from roadperc_stream.config import LimitsConfig, ReplayConfig, SurfaceConfig
from roadperc_stream.formats import images
from roadperc_stream.info.examine import examine
from roadperc_stream.input.earlier_replay import recorded_tag_table
from roadperc_stream.input.roles import tag_table_to_record
from roadperc_stream.input.stream import RoleAssignment
from roadperc_stream.log import Channel, LogWriter, Message, Metadata
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14, CARLA_FROM_0_9_14, table_for_version
from roadperc_stream.output import encoding
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.record import METADATA_RECORD, TAG_TABLE_KEY
from roadperc_stream.view.rerun.recording import save_recording
from tests import logs
from tests.replaying import replay

MAPILLARY_VISTAS = table_for_version("mapillary-vistas-1.2")
NAMED = ReplayConfig(tag_table="0.9.12")
OTHER = ReplayConfig(tag_table="0.9.15")


@pytest.fixture(scope="module")
def unnamed(tmp_path_factory):
    """A log as others record it: its tags are numbers, and nothing says of which table."""
    path = tmp_path_factory.mktemp("unnamed") / "in.mcap"
    with LogWriter(path) as writer:
        for item in logs.items(frames=3):
            channel = replace(logs.channel(item.role), metadata=())
            writer.write(Message(channel, item.stamp_ns, item.stamp_ns, 0, item.data))
    return path


@pytest.fixture(scope="module")
def result(unnamed):
    return replayed(unnamed, "result", NAMED)


def replayed(source, name, cfg):
    target = source.with_name(f"{name}.mcap")
    replay(source, target, cfg)
    return target


def recorded(path):
    return recorded_tag_table(log.summarise(path).metadata)


def drivable(path):
    return pl.read_parquet(sidecar_path(path, "metrics"))["drivable_ratio"].to_list()


def test_a_result_records_the_named_table(result):
    assert recorded(result) == CARLA_BEFORE_0_9_14.name


def test_a_replay_of_the_result_uses_the_recorded_table(unnamed, result):
    again = replayed(result, "again", ReplayConfig())
    assert drivable(again) == drivable(result) != drivable(replayed(unnamed, "without", ReplayConfig()))
    assert recorded(again) == recorded(result)
    messages = ([(m.channel.topic, m.data) for m in log.read(log.summarise(path))] for path in (result, again))
    assert next(messages) == next(messages)


def test_a_named_table_replaces_the_recorded_one(result):
    other = replayed(result, "other", OTHER)
    assert recorded(other) == CARLA_FROM_0_9_14.name
    assert drivable(other) != drivable(result)


def test_info_and_the_viewer_use_the_recorded_table(unnamed, result, tmp_path):
    facts = examine(result, {}).replay
    assert (facts.tag_table, dict(facts.unreadable), dict(facts.alone)) == (CARLA_BEFORE_0_9_14.name, {}, {})
    assert dict(save_recording(result, tmp_path / "a.rrd", {}).problems) == {}
    untold = examine(unnamed, {}).replay
    assert (untold.tag_table, dict(untold.unreadable)) == (None, {"/camera/front/segmentation": 3})
    assert dict(save_recording(unnamed, tmp_path / "b.rrd", {}).problems) == {"/camera/front/segmentation": 3}


def test_a_log_that_names_its_table_is_recorded_as_before(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=2))
    for cfg, name in ((ReplayConfig(), "auto"), (NAMED, "named")):
        assert TAG_TABLE_KEY not in record(replayed(source, name, cfg))


def record(path):
    return next(dict(record.values) for record in log.summarise(path).metadata if record.name == METADATA_RECORD)


def test_tags_of_mapillary_give_the_same_results(tmp_path):
    """The same road with Mapillary's numbers; where a part of it is parking, it is drivable once it is named so."""
    source = logs.write(tmp_path / "carla.mcap", logs.items(frames=2))
    road = drivable(replayed(source, "carla_out", ReplayConfig()))
    cfg = ReplayConfig(tag_table=MAPILLARY_VISTAS.name)
    assert drivable(replayed(in_numbers_of_mapillary(tmp_path, {}), "same", cfg)) == road
    parking = in_numbers_of_mapillary(tmp_path, {"road_line": "parking"})
    assert drivable(replayed(parking, "without", cfg)) < road
    named = SurfaceConfig(classes=("road", "ground", "parking"))
    assert drivable(replayed(parking, "named", cfg.model_copy(update={"surface": named}))) == road


def in_numbers_of_mapillary(folder, renamed):
    """The small log's tags in Mapillary's numbers, as a plain grey image, some classes as others."""
    numbers = np.zeros(256, np.uint8)
    for tag, name in enumerate(CARLA_BEFORE_0_9_14.names):
        wanted = renamed.get(name, name)
        numbers[tag] = MAPILLARY_VISTAS.names.index(wanted if wanted in MAPILLARY_VISTAS.names else "static")
    path = folder / f"mapillary_{len(renamed)}.mcap"
    with LogWriter(path) as writer:
        for item in logs.items(frames=2):
            channel, data = logs.channel(item.role), item.data
            if item.role == "segmentation":
                palette = CompressedImage.FromString(data)
                tags = images.decode_indices(palette.data, LimitsConfig())
                grey = cv2.imencode(".png", numbers[tags])[1].tobytes()
                channel, data = (
                    replace(channel, metadata=()),
                    encoding.encode_image(item.stamp_ns, "camera", "png", grey),
                )
            writer.write(Message(channel, item.stamp_ns, item.stamp_ns, 0, data))
    return path


@pytest.mark.parametrize(
    ("label", "recorded_before", "configured", "needed"),
    [
        ("", "", "auto", ""),
        ("", "", CARLA_FROM_0_9_14.name, CARLA_FROM_0_9_14.name),
        ("", CARLA_BEFORE_0_9_14.name, "auto", CARLA_BEFORE_0_9_14.name),
        ("", CARLA_BEFORE_0_9_14.name, CARLA_FROM_0_9_14.name, CARLA_FROM_0_9_14.name),
        (CARLA_BEFORE_0_9_14.name, "", CARLA_FROM_0_9_14.name, ""),
    ],
)
def test_only_what_is_needed_is_recorded(label, recorded_before, configured, needed):
    metadata = ((TAG_TABLE_KEY, label),) if label else ()
    tags = Channel("/seg", "cdr", "sensor_msgs/msg/Image", metadata=metadata)
    roles = RoleAssignment({"segmentation": "/seg"}, tag_table=recorded_before)
    assert tag_table_to_record([tags], roles, configured) == needed


@pytest.mark.parametrize("name", ["", "auto", "carla-of-tomorrow"])
def test_an_unknown_recorded_table_is_ignored(name):
    assert recorded_tag_table([Metadata(METADATA_RECORD, ((TAG_TABLE_KEY, name),))]) == ""
    assert recorded_tag_table([Metadata("another", ((TAG_TABLE_KEY, CARLA_FROM_0_9_14.name),))]) == ""
