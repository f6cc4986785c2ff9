"""A drive that is replayed in parts gives the rows of one pass."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.batch.joining import POSE, join
from roadperc_stream.batch.part_replay import read_part, replay_part
from roadperc_stream.batch.splitting import SplitPart, parts_of_log
from roadperc_stream.core.config import load_config
from roadperc_stream.core.time import NS_PER_S, TimeRange
from roadperc_stream.core.time import WHOLE as WHOLE_LOG
from roadperc_stream.input import ReplaySource
from roadperc_stream.output.tables import facts_in
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.state.opening import open_log
from tests import logs
from tests.state.parts import write

CFG = load_config(None, ("sync.max_wait_s=0.15",))
ROAD = replace(logs.SMALL, width=96, height=72)
FRAMES = 36
SPLIT_S = 0.5
SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
WHOLE = SplitPart(0, None, None)
OF_THE_FRAME = (
    *("frame", "stamp_ns", "segment", "sync_skew_ms", "missing", "log_id", "detections"),
    *("surface_inlier_ratio", "camera_height_m", "drivable_ratio", "lane_proposals", "lane_changes", "true_x_m"),
)
"""Columns that are equal to one pass's: of the frame alone, or counted on."""


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """The messages of a log that is quickly replayed."""
    path = logs.write(tmp_path_factory.mktemp("drive") / "in.mcap", logs.items(FRAMES, road=ROAD))
    return list(log.read(log.summarise(path)))


def tables(folder, messages, *, split_s=None, warm_up_s=0.3, asked=WHOLE_LOG, cfg=CFG):
    """Joined tables of a log as polars has them, and their notes."""
    folder.mkdir(exist_ok=True)
    source = ReplaySource(write(folder / "in.mcap", messages), time_range=asked)
    log_in = open_log(source, cfg).input
    parts = (replace(WHOLE, start_s=asked.start_s, end_s=asked.end_s),)
    if split_s is not None:
        parts = parts_of_log(log_in, cfg, split_s, asked)
        assert len(parts) > 1
    made = []
    for part in parts:
        replay_part(source, part, cfg, folder / f"{part.index}.mcap", warm_up_s)
        made.append(read_part(part, folder / f"{part.index}.mcap"))
    joined = join(log_in.log_id, made)
    assert facts_in(joined.metrics.schema.metadata)["log_id"] == log_in.log_id
    return pl.from_arrow(joined.metrics), pl.from_arrow(joined.objects), joined.notes


@pytest.fixture(scope="module")
def one_pass(drive, tmp_path_factory):
    return tables(tmp_path_factory.mktemp("whole"), drive)


def places(metrics):
    return metrics.select(POSE[:3]).to_numpy()


def require_same_frames(ours, theirs, columns=OF_THE_FRAME):
    assert ours.columns == theirs.columns
    assert ours.schema == theirs.schema
    for name in columns:
        assert ours[name].to_list() == theirs[name].to_list(), name


def require_tracks_of_frames(objects):
    """No name is given twice in a frame, and a name goes with one label."""
    named = objects.filter(pl.col("track_id").is_not_null())
    assert not named.select("frame", "track_id").is_duplicated().any()


def test_parts_are_one_pass(drive, one_pass, tmp_path):
    metrics, objects, notes = tables(tmp_path, drive, split_s=SPLIT_S)
    require_same_frames(metrics, one_pass[0])
    detection = ["frame", "stamp_ns", "label", "score", "kept", "distance_m", "track_id", "log_id"]
    assert objects.select(detection).equals(one_pass[1].select(detection))
    require_tracks_of_frames(objects)
    assert notes == ()


@pytest.mark.parametrize(("warm_up_s", "most_m"), [(0.0, 0.02), (0.5, 0.001)])
def test_the_path_of_a_drive_is_whole(warm_up_s, most_m, tmp_path):
    """The rendered sample, 20 m long; the bounds are twice what was measured."""
    sample = list(log.read(log.summarise(SAMPLE)))
    whole, whole_objects, _ = tables(tmp_path / "whole", sample)
    metrics, objects, notes = tables(tmp_path / "parts", sample, split_s=0.9, warm_up_s=warm_up_s)
    require_same_frames(metrics, whole)
    assert abs(objects["track_id"].n_unique() - whole_objects["track_id"].n_unique()) <= 1
    require_tracks_of_frames(objects)
    assert np.linalg.norm(places(metrics) - places(whole), axis=1).max() < most_m
    assert np.abs(metrics["lane_left_offset_m"] - whole["lane_left_offset_m"]).max() < 0.01
    assert notes == ()


def test_dropped_messages_and_a_camera_that_is_silent(drive, tmp_path):
    """Messages are missing one by one, and images for half a second across a cut."""
    first_ns, rng = drive[0].log_time_ns, np.random.default_rng(1)
    sensors = {ROLES[role].topic for role in ("depth", "segmentation", "detections")}

    def stays(message):
        silent = 0.6 < (message.log_time_ns - first_ns) / NS_PER_S < 1.1
        lost = rng.random() < 0.1
        is_image = message.channel.topic == ROLES["image"].topic
        return not (is_image and (silent or lost)) and not (message.channel.topic in sensors and lost)

    there = [message for message in drive if stays(message)]
    whole, _, _ = tables(tmp_path / "whole", there)
    metrics, objects, _ = tables(tmp_path / "parts", there, split_s=SPLIT_S)
    assert len(whole) < FRAMES - 8
    assert any("depth" in roles for roles in whole["missing"])
    require_same_frames(metrics, whole, ("frame", "stamp_ns", "segment", "missing", "detections", "lane_proposals"))
    require_tracks_of_frames(objects)


def test_a_log_that_goes_back_in_time(drive, tmp_path):
    """A drive played twice in one log: in each segment all begins anew, in parts as in one pass."""
    shift_ns = drive[-1].log_time_ns - drive[0].log_time_ns + NS_PER_S // 20
    again = [replace(message, log_time_ns=message.log_time_ns + shift_ns) for message in drive]
    whole, whole_objects, _ = tables(tmp_path / "whole", [*drive, *again])
    metrics, objects, _ = tables(tmp_path / "parts", [*drive, *again], split_s=SPLIT_S)
    require_same_frames(metrics, whole)
    assert metrics["segment"].max() == 1
    assert objects["track_id"].to_list() == whole_objects["track_id"].to_list()


def test_a_part_of_a_log_is_split_as_it_is_replayed(drive, tmp_path):
    asked = TimeRange(0.2, 1.5)
    whole, _, _ = tables(tmp_path / "whole", drive, asked=asked, warm_up_s=0.2)
    metrics, _, _ = tables(tmp_path / "parts", drive, split_s=SPLIT_S, asked=asked, warm_up_s=0.2)
    require_same_frames(metrics, whole, ("frame", "stamp_ns", "log_id", "missing", "detections"))


def test_without_odometry_there_is_no_path(drive, tmp_path):
    cfg = load_config(None, ("sync.max_wait_s=0.15", "odometry.enabled=false"))
    metrics, _, notes = tables(tmp_path, drive, split_s=SPLIT_S, cfg=cfg)
    assert metrics["odom_x_m"].null_count() == len(metrics)
    assert notes == ()


def test_a_short_log_is_one_pass(drive, one_pass, tmp_path):
    log_in = open_log(ReplaySource(write(tmp_path / "in.mcap", drive)), CFG).input
    assert parts_of_log(log_in, CFG, 2.0) == (WHOLE,)
    assert one_pass[0]["log_id"].unique().to_list() == [log_in.log_id]
