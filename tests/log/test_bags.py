"""ROS bags are read as the MCAP log with the same messages."""

import re
import sqlite3
from dataclasses import replace

import pytest
from mcap.writer import Writer as McapWriter
from rosbags import rosbag1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from roadperc_stream import log
from roadperc_stream.cli.convert import main as convert_main
from roadperc_stream.cli.info import main as info_main
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.errors import LogError
from roadperc_stream.schemas import cdr
from roadperc_stream.schemas.topics import METRICS_TOPIC
from tests.input import test_elsewhere as elsewhere

FRAMES = 2
SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
NOETIC = get_typestore(Stores.ROS1_NOETIC)
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


def ros1_mcap(path, bag):
    """The messages of a ROS 1 bag in MCAP, as ``mcap convert`` writes them: with names and definitions of ROS 1."""
    with path.open("wb") as stream, rosbag1.Reader(bag) as reader:
        writer = McapWriter(stream)
        writer.start("ros1")
        known = {}
        for c in reader.connections:
            is_known = c.msgtype in NOETIC.fielddefs  # CameraInfo with fields in upper case
            text = NOETIC.generate_msgdef(c.msgtype)[0] if is_known else c.msgdef.data
            schema = writer.register_schema(c.msgtype.replace("/msg/", "/"), "ros1msg", text.encode())
            known[c.id] = writer.register_channel(c.topic, "ros1", schema)
        for c, time_ns, data in reader.messages():
            writer.add_message(known[c.id], time_ns, bytes(data), time_ns)
        writer.finish()
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
    return [
        (m.channel.topic, m.log_time_ns, m.data) for m in log.read(log.summarise(path)) if m.channel.label("producer")
    ]


@pytest.fixture(scope="module")
def result(single, tmp_path_factory):
    return replayed(tmp_path_factory.mktemp("result"), single)


@pytest.mark.parametrize(("storage", "mode"), KINDS)
def test_every_form_of_a_bag_has_the_messages_of_the_log(tmp_path, single, messages, storage, mode):
    folder = bag(tmp_path / "bag", messages, storage, mode)
    assert contents(folder) == contents(single)
    (file,) = set(folder.iterdir()) - {folder / "metadata.yaml"}
    assert contents(file) == contents(single)


@pytest.mark.parametrize("storage", [SQLITE, MCAP], ids=["db3", "mcap"])
def test_a_split_bag_replays_to_the_results_of_the_single_file(tmp_path, single, messages, result, storage):
    folder = split_bag(tmp_path / "bag", messages, storage)
    assert contents(folder) == contents(single)
    assert results(replayed(tmp_path, folder)) == results(result)


def test_a_ros_1_bag_replays_to_the_results_of_the_log(tmp_path, messages, result):
    assert results(replayed(tmp_path, ros1_bag(tmp_path / "in.bag", messages))) == results(result)


def test_mcap_of_profile_ros1_replays_to_the_results_of_the_bag_and_is_kept(tmp_path, messages, result):
    path = ros1_mcap(tmp_path / "in.mcap", ros1_bag(tmp_path / "in.bag", messages))
    target = replayed(tmp_path, path)
    estimates = [[m for m in results(one) if m[0] != METRICS_TOPIC] for one in (target, result)]  # these name the log
    assert estimates[0] == estimates[1]
    assert [m for m in contents(target) if not m[0].startswith("/perception/")] == contents(path)


def test_a_db3_file_without_definitions_has_those_of_ros_2(tmp_path, messages):
    (path,) = bag(tmp_path / "bag", messages).glob("*.db3")
    with sqlite3.connect(path) as database:
        database.execute("DROP TABLE message_definitions")
    found = {c.schema_name: c.schema_data for c in log.summarise(log.received([path])).channels}
    assert b"uint32 width" in found["sensor_msgs/msg/Image"]
    assert found["vision_msgs/msg/Detection2DArray"] == b""


def test_a_cut_db3_file_is_recovered(tmp_path, messages, capsys):
    (path,) = bag(tmp_path / "bag", messages).glob("*.db3")
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    assert replay_main([str(path), str(tmp_path / "out.mcap")]) == 1
    error = capsys.readouterr().err
    assert f"{path}: damaged at byte " in error
    assert "cut off: database disk image is malformed; " in error
    assert info_main([str(path)]) == 1
    assert "written by rosbag2 (db3), read as MCAP" in capsys.readouterr().out
    assert replay_main([str(tmp_path / "bag"), str(tmp_path / "out.mcap"), "--recover"]) == 0
    assert "messages saved, others are lost" in capsys.readouterr().out


def refused(path):
    with pytest.raises(LogError) as raised:
        log.received([path])
    return str(raised.value)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (metadata("bag.db3", "bag_1.db3"), "bag_1.db3: missing, but metadata.yaml names it"),
        (metadata(), "metadata.yaml: names no files"),
        (metadata("bag.db3", more="  compression_format: lz4\n"), "compression 'lz4'"),
        ("rosbag2_bagfile_information: {}\n", "missing required field `relative_file_paths`"),
        ("a: [b", "metadata.yaml: "),
    ],
)
def test_a_folder_that_does_not_fit_its_metadata_is_refused_with_a_command(tmp_path, messages, text, fault):
    folder = bag(tmp_path / "bag", messages[:3])
    (folder / "metadata.yaml").write_text(text)
    assert fault in refused(folder)
    assert refused(folder).endswith(f": roadperc-replay {folder / 'bag.db3'} OUT.mcap")


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"SQLite format 3\0" + bytes(2000), "file is not a database; repair it with: sqlite3 "),
        (b"#ROSBAG V2.0\n", "Header could not be read from file.; repair it with: rosbag reindex "),
    ],
)
def test_an_unreadable_bag_is_named_with_a_command(tmp_path, content, fault):
    path = tmp_path / "a b"
    path.write_bytes(content)
    assert refused(path).startswith(f"{path}: {fault}'{path}'")


def test_a_damaged_message_is_named(tmp_path, messages):
    (path,) = bag(tmp_path / "bag", messages, mode="MESSAGE").glob("*.db3")
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET data = substr(data, 1, 20) WHERE id = 9")
    (file,) = log.received([path])
    topic = messages[8].channel.topic
    assert f"{topic}: message at {messages[8].log_time_ns} ns: " in log.audited(file).damages[0].words


def test_a_bag_without_files_has_no_command_for_them(tmp_path):
    (tmp_path / "metadata.yaml").write_text(metadata("bag.db3"))
    assert refused(tmp_path).endswith("names it; copy the whole folder of the bag again")


@pytest.mark.parametrize("storage", [SQLITE, MCAP], ids=["db3", "mcap"])
def test_a_compressed_file_without_metadata_is_read_and_named(tmp_path, single, messages, storage):
    folder = bag(tmp_path / "bag", messages, storage, "FILE")
    (folder / "metadata.yaml").unlink()
    (file,) = folder.iterdir()
    assert file.suffix == ".zstd"
    assert contents(file) == contents(single)
    with pytest.raises(LogError, match=f"such as {re.escape(str(file))}"):
        log.summarise(folder)
    if storage == MCAP:
        with pytest.raises(LogError, match=f"zstd -d {re.escape(str(file))}"):
            log.summarise(file)


def test_compressed_messages_without_metadata_name_the_folder(tmp_path, messages, capsys):
    folder = bag(tmp_path / "bag", messages, MCAP, "MESSAGE")
    (folder / "metadata.yaml").unlink()
    assert replay_main([*map(str, folder.iterdir()), str(tmp_path / "out.mcap")]) == 1
    assert "are compressed: replay the folder of the bag" in capsys.readouterr().err


def test_a_bag_without_video_is_not_converted(tmp_path, messages, capsys):
    folder = bag(tmp_path / "bag", messages[:3])
    assert convert_main([str(folder), str(tmp_path / "in.mcap")]) == 1
    assert f"replay it with: roadperc-replay {folder} OUT.mcap" in capsys.readouterr().err


def test_info_lists_every_file_of_a_bag_and_proposes_the_topic(tmp_path, messages, capsys):
    image = "/carla/ego_vehicle/rgb_front/image"
    renamed = [replace(m, channel=replace(m.channel, topic="/b/picture")) for m in messages if m.channel.topic == image]
    folder = split_bag(tmp_path / "bag", sorted([*messages, *renamed], key=lambda m: m.log_time_ns), MCAP)
    assert info_main([str(folder), "--topic", "image=/none"]) == 0
    out = capsys.readouterr().out
    assert all(f"{folder / f'bag_{n}.mcap'}: whole" in out for n in range(3))
    assert "As files of one log" in out
    assert f"to use this topic: roadperc-replay {folder} OUT.mcap --topic image={image}" in out


def test_a_bag_alone_needs_an_output(tmp_path, messages, capsys):
    folder = bag(tmp_path / "bag", messages[:1])
    with pytest.raises(SystemExit):
        replay_main([str(folder)])
    assert "required: OUT.mcap" in capsys.readouterr().err
