"""The real server, driven as a viewer does over a WebSocket: a finished log, and a replay that is running."""

import re
import shlex
import signal
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from threading import Event, Thread

import polars as pl
import pytest
from websockets.exceptions import WebSocketException

from roadperc_stream import log
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.config import load_config
from roadperc_stream.errors import LogError
from roadperc_stream.log import Channel, LogWriter, Message
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.roadperc_pb2 import StageTimes
from roadperc_stream.schemas.topics import RESULTS, TIMES_TOPIC
from roadperc_stream.view.live import PlaybackOptions
from roadperc_stream.view.live.serving import LiveReplay, ServeError, log_with_times, playing, serve_log
from tests import logs
from tests.analytic import STEP_NS
from tests.replaying import replay
from tests.view.live.client import PATIENCE_S, Viewer

S = 1_000_000_000
CHANNELS = (
    Channel("/calibration", "protobuf", "x.Calibration", "protobuf", b"\x00\xff", (("sensor", "front"),)),
    Channel("/image", "cdr", "y/msg/Image", "ros2msg", b"uint8[] data"),
    Channel("/silent", "protobuf", "x.Silent", "protobuf", b"\x01"),
    Channel("/plain", "raw"),
)


@pytest.fixture
def path(tmp_path):
    """A minute: a calibration at the start, an image ten times a second."""
    with LogWriter(tmp_path / "log.mcap") as writer:
        for channel in CHANNELS:
            writer.register(channel)
        writer.write(Message(CHANNELS[0], 1000 * S, 1000 * S, 0, b"calibration"))
        for k in range(600):
            time_ns = 1000 * S + k * S // 10
            writer.write(Message(CHANNELS[1], time_ns, time_ns, k, b"image %d" % k))
    return tmp_path / "log.mcap"


@contextmanager
def served(path, **options):
    source = log_with_times(path)
    span_ns, options = (source.reach().first_ns, source.reach().last_ns), PlaybackOptions(port=0, **options)
    with playing(source, "log", span_ns, options, None) as (player, audience):
        thread = Thread(target=player.run, args=(audience,))
        thread.start()
        try:
            yield audience.server.port
        finally:
            player.stop()
            thread.join()


def test_the_server_says_what_it_can_and_has(path):
    with served(path) as port, Viewer(port) as viewer:
        assert viewer.socket.subprotocol == "foxglove.sdk.v1"
        assert {"time", "playbackControl"} <= set(viewer.info["capabilities"])
        assert viewer.info["dataStartTime"] == {"sec": 1000, "nsec": 0}
        assert viewer.info["dataEndTime"] == {"sec": 1059, "nsec": 900_000_000}
        told = {c["topic"]: c for c in viewer.channels.values()}
        assert told.keys() == {channel.topic for channel in CHANNELS}
        for channel in CHANNELS[:3]:
            found = told[channel.topic]
            assert (found["encoding"], found["schemaName"]) == (channel.message_encoding, channel.schema_name)
            assert (found["schemaEncoding"], viewer.schema(found)) == (channel.schema_encoding, channel.schema_data)
        assert told["/calibration"]["metadata"] == {"sensor": "front"}


def test_messages_come_with_their_log_times_and_bytes(path):
    with served(path, start_s=50.0) as port, Viewer(port) as viewer:
        viewer.control(play=False)  # all is subscribed before the first message is due
        viewer.subscribe()
        logged = [(m.channel.topic, m.log_time_ns, m.data) for m in log.read(log.summarise(path))]
        held, played = logged[:1], [item for item in logged if item[1] >= 1050 * S]
        viewer.until(lambda: len(viewer.shown()) == 2)
        assert sorted(map(tuple, viewer.shown())) == held + played[:1]
        viewer.control(play=True, rate=20.0)
        viewer.until(lambda: [s for s in viewer.states() if s.status == "ended"] and len(viewer.shown()) == 99)
        assert [tuple(m) for m in viewer.shown()] == played[1:]
        assert viewer.states()[-1][1:4] == (1000 * S + 59_900_000_000, 20.0, False)


def test_pause_seek_and_speed(path):
    with served(path) as port, Viewer(port) as viewer:
        viewer.subscribe()
        viewer.until(lambda: len(viewer.shown("/image")) > 2)
        paused = viewer.control(play=False)
        assert (paused.status, paused.moved) == ("paused", False)
        assert viewer.control(play=False).log_ns == paused.log_ns  # the time stands
        sought = viewer.control(play=False, seek_ns=1030 * S + 1)
        assert sought[:4] == ("paused", 1030 * S + 1, 1.0, True)
        viewer.until(lambda: len(viewer.shown()) == 2)  # a whole frame, and nothing from before the seek
        assert sorted(viewer.shown()) == [
            ("/calibration", 1000 * S, b"calibration"),
            ("/image", 1030 * S, b"image 300"),
        ]
        fast = viewer.control(play=True, rate=20.0)
        assert (fast.status, fast.rate) == ("playing", 20.0)
        viewer.until(lambda: len(viewer.shown()) == 50)
        assert [m.data for m in viewer.shown()] == [b"image %d" % k for k in range(301, 351)]
        back = viewer.control(play=True, seek_ns=1010 * S)
        assert (back.log_ns, back.moved) == (1010 * S, True)
        viewer.until(lambda: [m for m in viewer.shown() if m.data == b"image 102"])


@pytest.mark.promise("The live server", "The server answers while the disk is blocked")
def test_a_disk_that_stands_still_keeps_no_viewer_from_an_answer(path, monkeypatch):
    """The server has a few threads for all its viewers: none of them may wait for what a seek reads."""
    reading, on, ends = Event(), Event(), []
    read = log.read

    def slow(summary, *, end_ns=None, **limits):
        ends.append(end_ns)
        reading.set()
        on.wait()
        return read(summary, end_ns=end_ns, **limits)

    with served(path) as port, Viewer(port) as first:
        monkeypatch.setattr(log, "read", slow)
        try:
            first.order("waited for", play=False, seek_ns=1001 * S)
            assert reading.wait(PATIENCE_S)
            for k in range(200):
                first.order(f"seek {k}", play=False, seek_ns=1010 * S + k)
            with Viewer(port) as second:
                answer = second.control(play=False, rate=3.0)
                assert (answer.status, answer.rate) == ("paused", 3.0)  # anywhere: viewers' orders come in any order
            first.until(lambda: len(first.states()) == 202)
        finally:
            on.set()
        first.subscribe("/image")
        first.until(lambda: [shown for shown in first.shown() if shown.data == b"image 100"])
    assert not {1010 * S + k + 1 for k in range(199)} & set(ends)
    assert 1010 * S + 200 in ends


@pytest.mark.promise("The live server", "A viewer that seeks 200 times a second does not block a second viewer")
def test_a_storm_of_seeks_leaves_a_second_viewer_an_answer(path):
    """The storm lasts until the answer is there, with twenty seeks on their way: as many as are answered."""
    raging, ended = Event(), Event()

    def storm():
        while not ended.is_set():
            first.heard.clear()
            for k in range(20):
                first.order("seek", play=k % 2 == 0, seek_ns=1000 * S + k * 7919 * S // 1000 % (59 * S))
            first.until(lambda: sum(state.request_id == "seek" for state in first.states()) == 20)
            raging.set()

    with served(path) as port, Viewer(port) as first, ThreadPoolExecutor() as threads:
        first.subscribe()
        storming = threads.submit(storm)
        try:
            assert raging.wait(PATIENCE_S)
            with Viewer(port) as second:
                second.subscribe()
                second.until(lambda: second.shown("/image"))
                second.order("second", play=False)
                second.until(lambda: [s for s in second.states() if s.request_id == "second"])
        finally:
            ended.set()
        storming.result()


def test_who_comes_after_the_end_knows_the_time_and_sees_the_last_frame(path):
    with served(path, start_s=59.0, rate=20.0) as port:
        with Viewer(port) as first:
            first.subscribe()
            first.until(lambda: [s for s in first.states() if s.status == "ended"])
        with Viewer(port) as second:
            second.subscribe()
            second.until(lambda: len(second.shown()) >= 2)
            assert {m.data for m in second.shown()} == {b"calibration", b"image 599"}
            assert (1059_900_000_000,) in second.until(lambda: [t for t in second.heard if len(t) == 1])
            assert second.until(second.states)[-1][:2] == ("ended", 1059_900_000_000)


def test_a_viewer_that_sleeps_does_not_keep_the_server_from_ending(tmp_path):
    path, image = tmp_path / "large.mcap", CHANNELS[1]
    with log.LogWriter(path) as writer:
        for k in range(100):
            writer.write(log.Message(image, 1000 * S + k, 1000 * S + k, k, bytes(500_000)))
    serving = ExitStack()
    port = serving.enter_context(served(path))
    asleep = Viewer(port)
    asleep.subscribe()
    asleep.until(asleep.shown)  # and from here on it hears nothing more
    with Viewer(port) as awake:
        awake.subscribe()
        awake.until(lambda: [s for s in awake.states() if s.status == "ended"])
    ending = Thread(target=serving.close, daemon=True)
    ending.start()
    ending.join(PATIENCE_S)
    assert not ending.is_alive()
    asleep.socket.close_socket()


def test_a_loop_begins_a_new_session(path):
    """Viewers that know no seek join the last message to the next one, unless they are made to forget the last.

    They forget the schemas as well, so that the channels of the new session have to be new.
    """
    with served(path, start_s=59.0, rate=20.0, loop=True) as port, Viewer(port) as viewer:
        before = dict(viewer.channels)
        viewer.subscribe()
        viewer.until(lambda: len(viewer.sessions) == 2 and len(viewer.channels) == len(CHANNELS))
        assert viewer.shown("/image")[-1].data == b"image 599"
        first, second = viewer.sessions
        assert first != second
        assert viewer.info["dataEndTime"] == {"sec": 1059, "nsec": 900_000_000}
        assert not before.keys() & viewer.channels.keys()
        parts = ("topic", "encoding", "schemaName", "schema", "metadata")
        old, new = ([[c.get(part) for part in parts] for c in known.values()] for known in (before, viewer.channels))
        assert sorted(old, key=str) == sorted(new, key=str)
        viewer.heard.clear()
        viewer.control(play=False)  # all is subscribed before the first message is due
        viewer.subscribe()
        viewer.until(lambda: len(viewer.shown()) == 2)
        assert {m.data for m in viewer.shown()} == {b"calibration", b"image 590"}
        viewer.control(play=True, rate=20.0)
        viewer.until(lambda: [s for s in viewer.states() if s.status == "ended"] and len(viewer.shown()) == 9)
        assert [m.data for m in viewer.shown()] == [b"image %d" % k for k in range(591, 600)]
        times = [item[0] for item in viewer.heard if len(item) == 1]
        assert 1059 * S <= times[0] < 1060 * S
        assert times == sorted(times)


def test_only_this_machine_unless_told_otherwise(path):
    with served(path) as port, pytest.raises(ConnectionRefusedError):
        Viewer(port, "127.0.0.2")
    with served(path, host="0.0.0.0") as port, Viewer(port, "127.0.0.2") as viewer:
        assert viewer.channels


def test_a_port_in_use_is_stated(path):
    with served(path) as port, pytest.raises(ServeError, match=rf"127\.0\.0\.1:{port}: .*in use.*--port 0"):
        serve_log(path, PlaybackOptions(port=port))


@pytest.mark.parametrize("start_s", [-1, 60])
def test_a_start_outside_the_log_is_stated(path, start_s):
    with pytest.raises(LogError, match=r"--start .*expected 0 to 59\.900"):
        serve_log(path, PlaybackOptions(port=0, start_s=start_s))


FRAMES = 8
FIRST_NS = logs.START_NS


@pytest.fixture
def source(tmp_path):
    return logs.write(tmp_path / "in.mcap", logs.items(FRAMES))


def told_times(viewer):
    """Log time and milliseconds of each stage, as they came."""
    told = [(m.log_time_ns, StageTimes.FromString(m.data)) for m in viewer.shown(TIMES_TOPIC)]
    return [(log_time_ns, *(getattr(times, name) for name in TIME_COLUMNS)) for log_time_ns, times in told]


def table_times(target):
    """The same from the table; a stage that did not run took no time."""
    times = pl.read_parquet(sidecar_path(target, "metrics")).select("stamp_ns", pl.col(TIME_COLUMNS).fill_null(0.0))
    return times.rows()


@contextmanager
def replay_held_at(frame, source, target):
    """A replay in a thread that stops at a frame; gives its port and how to let it come to its end."""
    reached, on = Event(), Event()

    def progress(done, _expected):
        if done == frame:
            reached.set()
            on.wait()

    def finish():
        on.set()
        thread.join()

    with LiveReplay(PlaybackOptions(port=0), quiet=True) as live:
        job = {"progress": progress, "on_start": live.start, "on_frame": live.times.note}
        thread = Thread(target=replay, args=(source, target, load_config(None, ())), kwargs=job)
        thread.start()
        try:
            assert reached.wait(PATIENCE_S)
            yield live.port, finish
        finally:
            finish()


def test_a_running_replay_is_watched_and_sought(source, tmp_path):
    target, computed_ns = tmp_path / "out.mcap", FIRST_NS + 4 * STEP_NS
    with replay_held_at(5, source, target) as (port, finish), Viewer(port) as viewer:
        viewer.subscribe()
        viewer.until(lambda: any(s.status == "buffering" for s in viewer.states()))
        assert not target.exists()
        viewer.control(play=False)
        beyond = viewer.control(play=False, seek_ns=FIRST_NS + 7 * STEP_NS)
        assert (beyond.log_ns, beyond.moved) == (computed_ns - 1, True)
        assert re.match(r"the replay is 0\.\d s short of", viewer.until(lambda: viewer.warnings)[0])
        viewer.until(lambda: viewer.shown("/perception/lanes"))
        viewer.control(play=False)
        back = viewer.control(play=False, seek_ns=FIRST_NS + STEP_NS)
        assert back.log_ns == FIRST_NS + STEP_NS
        viewer.until(lambda: viewer.shown("/perception/lanes"))
        assert viewer.shown("/perception/lanes")[-1].log_time_ns == FIRST_NS + STEP_NS
        viewer.control(play=False)
        finish()
        viewer.control(play=True, rate=5.0, seek_ns=FIRST_NS)
        written = [(m.channel.topic, m.log_time_ns, m.data) for m in log.read(log.summarise(target))]
        viewer.until(lambda: len(viewer.shown()) == len(written) + FRAMES)
        assert sorted(tuple(m) for m in viewer.shown() if m.topic != TIMES_TOPIC) == sorted(written)
        assert told_times(viewer) == table_times(target)


def test_a_finished_log_is_served_with_the_times_of_its_table(source, tmp_path):
    target = tmp_path / "out.mcap"
    replay(source, target, load_config(None, ()))
    assert log_with_times(target).channels[-1].topic == TIMES_TOPIC
    with served(target) as port, Viewer(port) as viewer:
        viewer.subscribe(TIMES_TOPIC)
        viewer.until(lambda: len(viewer.shown()) == FRAMES)
        assert told_times(viewer) == table_times(target)
        viewer.control(play=False, seek_ns=FIRST_NS + 3 * STEP_NS)
        viewer.until(viewer.shown)
        assert told_times(viewer) == table_times(target)[3:4]


@pytest.mark.parametrize("table", ["none", "another log's"])
def test_without_a_table_of_its_own_no_times_are_offered(source, tmp_path, table):
    target, other = tmp_path / "out.mcap", tmp_path / "other.mcap"
    replay(source, target, load_config(None, ()))
    sidecar_path(target, "metrics").unlink()
    if table != "none":
        replay(logs.write(tmp_path / "in2.mcap", logs.items(FRAMES - 1)), other, load_config(None, ()))
        sidecar_path(other, "metrics").replace(sidecar_path(target, "metrics"))
    with served(target) as port, Viewer(port) as viewer:
        told = {channel["topic"] for channel in viewer.channels.values()}
        assert set(RESULTS) <= told
        assert TIMES_TOPIC not in told


def test_the_output_is_the_same_watched_or_not(source, tmp_path):
    replay(source, tmp_path / "alone.mcap", load_config(None, ()))
    with LiveReplay(PlaybackOptions(port=0, rate=50.0), quiet=True) as live:
        replay(source, tmp_path / "live.mcap", load_config(None, ()), on_start=live.start, on_frame=live.times.note)
    assert (tmp_path / "live.mcap").read_bytes() == (tmp_path / "alone.mcap").read_bytes()
    with pytest.raises((ConnectionError, WebSocketException)):  # refused, or cut off by a server that is ending
        Viewer(live.port)


def test_a_replay_whose_port_is_taken_leaves_nothing(source, tmp_path, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert replay_main([str(source), str(tmp_path / "out.mcap"), "--live", "--port", port]) == 1
    assert f"error: 127.0.0.1:{port}" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["in.mcap"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["--rate", "2"],
        ["--loop"],
        ["--host", "::1"],
        ["--port", "0"],
        ["--live", "--rate", "0"],
        ["--live", "--port", "70000"],
    ],
)
def test_wrong_usage(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        replay_main(["in.mcap", "out.mcap", *arguments])
    assert ended.value.code == 2
    assert next(word for word in arguments[::-1] if word.startswith("--")) in capsys.readouterr().err


SERVE = "import sys; from pathlib import Path; from roadperc_stream.cli.plumbing import run;"
SERVE += (
    "from roadperc_stream.view.live.serving import serve_log; from roadperc_stream.view.live import PlaybackOptions;"
)
SERVE += "sys.exit(run(lambda: serve_log(Path(sys.argv[1]), PlaybackOptions(port=0))))"
REPLAY = "import sys; from roadperc_stream.cli.replay import main; sys.exit(main(sys.argv[1:]))"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("command", ["serve", "replay"])
def test_ctrl_c_ends_it_well(source, tmp_path, command, number):
    target = tmp_path / "out.mcap"
    code, arguments = (SERVE, [source]) if command == "serve" else (REPLAY, [source, target, "--live", "--port", "0"])
    started = subprocess.Popen([sys.executable, "-c", code, *map(str, arguments)], stdout=-1, stderr=-1, text=True)
    port = int(re.search(r"ws://127\.0\.0\.1:(\d+) ", started.stdout.readline())[1])
    started.stdout.readline()
    layout = shlex.split(started.stdout.readline().partition("Import from file: roadperc-view ")[2])
    own = [str(source), "--foxglove", "--foxglove-layout", str(source.with_suffix(".layout.json"))]
    assert layout == (own if command == "serve" else ["--foxglove-layout", "layout.json"])
    with Viewer(port) as viewer:
        viewer.subscribe("/camera/front/image")
        viewer.until(viewer.shown)
        if command == "replay":
            assert any("still served" in line for line in started.stdout)
        started.send_signal(number)
        _, errors = started.communicate(timeout=PATIENCE_S)
    assert (started.returncode, errors) == (0, "")
    assert target.exists() == (command == "replay")
