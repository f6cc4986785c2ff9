"""ROS bags are read as the MCAP log with the same messages."""

import sqlite3
from pathlib import Path

import pytest
import zstandard
from rosbags import rosbag1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from roadperc_stream import log
from roadperc_stream.cli.compare import main as compare_main
from roadperc_stream.cli.info import main as info_main
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.errors import LogError
from roadperc_stream.schemas import cdr
from tests.input import test_elsewhere as elsewhere

FRAMES = 3
SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
KINDS = [(SQLITE, None), (SQLITE, "MESSAGE"), (SQLITE, "FILE"), (MCAP, None), (MCAP, "MESSAGE"), (MCAP, "FILE")]


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    """A bag in one MCAP file."""
    messages = [m for m in log.read(log.summarise(elsewhere.SAMPLE)) if m.channel.topic in elsewhere.TOPICS]
    last_ns = sorted({m.log_time_ns for m in messages})[FRAMES - 1]
    path = tmp_path_factory.mktemp("single") / "in.mcap"
    return elsewhere.bag(path, [m for m in messages if m.log_time_ns <= last_ns])


@pytest.fixture(scope="module")
def messages(single):
    return [*log.read(log.summarise(single))]


def bag(folder, messages, storage=SQLITE, mode=None):
    """Write a ROS 2 bag."""
    writer = Writer(folder, version=9, storage_plugin=storage)
    if mode is not None:
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        known = {}
        for m in messages:
            c = m.channel
            if c not in known:
                text = c.schema_data.decode()
                known[c] = writer.add_connection(c.topic, c.schema_name, msgdef=text, rihs01="RIHS01_0")
            writer.write(known[c], m.log_time_ns, m.data)
    return folder


def ros1_bag(path, messages):
    with rosbag1.Writer(path) as writer:
        known = {}
        for m in messages:
            c = m.channel
            store = cdr.layout_of(c.schema_name, c.schema_data)
            if c not in known:
                known[c] = writer.add_connection(c.topic, c.schema_name, typestore=store)
            writer.write(known[c], m.log_time_ns, store.cdr_to_ros1(m.data, c.schema_name))
    return path


def split_bag(folder, messages, storage):
    """A bag in several files, as ``ros2 bag record --max-bag-duration`` writes it."""
    folder.mkdir()
    names = []
    size = len(messages) // 3 + 1
    for number, some in enumerate(messages[start : start + size] for start in range(0, len(messages), size)):
        (made,) = bag(folder / f"{number}", some, storage).glob(f"{number}.*")
        made.rename(folder / f"bag_{number}{made.suffix}")
        names.append(f"bag/bag_{number}{made.suffix}")
    (folder / "metadata.yaml").write_text(metadata(*names))
    return folder


def metadata(*names, more=""):
    return f"rosbag2_bagfile_information:\n  version: 3\n  relative_file_paths: [{', '.join(names)}]\n{more}"


def contents(*paths):
    """Topic, type, time and bytes of the messages of a log."""
    found = log.read(log.summarise(log.received(paths)))
    return [(m.channel.topic, m.channel.schema_name, m.log_time_ns, m.data) for m in found]


def replayed(tmp_path, *paths):
    target = tmp_path / "out.mcap"
    assert replay_main([*map(str, paths), str(target), "--quiet"]) == 0
    return target


def results(path):
    return [(m.channel.topic, m.log_time_ns, m.data) for m in log.read(log.summarise(path)) if m.channel.metadata]


@pytest.fixture(scope="module")
def result(single, tmp_path_factory):
    return replayed(tmp_path_factory.mktemp("result"), single)


@pytest.mark.parametrize(("storage", "mode"), KINDS)
def test_every_form_of_a_bag_has_the_messages_of_the_log(tmp_path, single, messages, storage, mode):
    folder = bag(tmp_path / "bag", messages, storage, mode)
    assert contents(folder) == contents(single)
    if mode != "MESSAGE" or storage == SQLITE:
        (file,) = set(folder.iterdir()) - {folder / "metadata.yaml"}
        assert contents(file) == contents(single)
