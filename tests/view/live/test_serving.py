"""The real server with a viewer over a WebSocket, for a finished log and for a running replay."""

import re
import shlex
import shutil
import signal
import socket
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from threading import Event, Thread

import polars as pl
import pytest
from websockets.exceptions import ConnectionClosed, WebSocketException

from roadperc_stream import log
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.config import load_config
from roadperc_stream.errors import LogError
from roadperc_stream.log import Channel, LogWriter, Message
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.row_messages import StageTimes
from roadperc_stream.schemas.topics import RESULTS, TIMES_TOPIC
from roadperc_stream.view.live import PlaybackOptions
from roadperc_stream.view.live import serving as live_serving
from roadperc_stream.view.live.serving import LiveReplay, ServeError, log_with_times, playing, serve_log
from tests import commands, logs
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
    """A log of a minute with a calibration at the start and ten images per second."""
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


def test_the_server_announces_its_capabilities_and_channels(path):
    with served(path) as port, Viewer(port) as viewer:
        assert viewer.socket.subprotocol == "foxglove.sdk.v1"
        assert {"time", "playbackControl"} <= set(viewer.info["capabilities"])
        assert viewer.info["dataStartTime"] == {"sec": 1000, "nsec": 0}
        assert viewer.info["dataEndTime"] == {"sec": 1059, "nsec": 900_000_000}
        advertised = {c["topic"]: c for c in viewer.channels.values()}
        assert advertised.keys() == {channel.topic for channel in CHANNELS}
        for channel in CHANNELS[:3]:
            found = advertised[channel.topic]
            assert (found["encoding"], found["schemaName"]) == (channel.message_encoding, channel.schema_name)
            assert (found["schemaEncoding"], viewer.schema(found)) == (channel.schema_encoding, channel.schema_data)
        assert advertised["/calibration"]["metadata"] == {"sensor": "front"}


def test_messages_arrive_with_their_log_times_and_bytes(path):
    with served(path, start_s=50.0) as port, Viewer(port) as viewer:
        viewer.control(play=False)  # subscribe before the first message is due
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
        assert viewer.control(play=False).log_ns == paused.log_ns  # paused
        sought = viewer.control(play=False, seek_ns=1030 * S + 1)
        assert sought[:4] == ("paused", 1030 * S + 1, 1.0, True)
        viewer.until(lambda: len(viewer.shown()) == 2)  # a whole frame, and nothing older
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


def test_the_server_answers_while_the_disk_is_blocked(path, monkeypatch):
    """The server has few threads for all viewers, so none of them may wait for the read of a seek."""
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
            first.request("blocked", play=False, seek_ns=1001 * S)
            assert reading.wait(PATIENCE_S)
            for k in range(200):
                first.request(f"seek {k}", play=False, seek_ns=1010 * S + k)
            with Viewer(port) as second:
                answer = second.control(play=False, rate=3.0)
                assert (answer.status, answer.rate) == ("paused", 3.0)  # requests are not ordered
            first.until(lambda: len(first.states()) == 202)
        finally:
            on.set()
        first.subscribe("/image")
        first.until(lambda: [shown for shown in first.shown() if shown.data == b"image 100"])
    assert not {1010 * S + k + 1 for k in range(199)} & set(ends)
    assert 1010 * S + 200 in ends


def test_many_seeks_of_a_viewer_do_not_block_a_second_viewer(path):
    """The first viewer seeks until the second one has its answer, with twenty seeks under way."""
    raging, ended = Event(), Event()

    def storm():
        while not ended.is_set():
            first.heard.clear()
            for k in range(20):
                first.request("seek", play=k % 2 == 0, seek_ns=1000 * S + k * 7919 * S // 1000 % (59 * S))
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
                second.request("second", play=False)
                second.until(lambda: [s for s in second.states() if s.request_id == "second"])
        finally:
            ended.set()
        storming.result()


@pytest.mark.parametrize("pause_s", [0.0, 0.0002])
def test_a_flood_of_seeks_closes_no_other_connection(path, pause_s):
    """The SDK closes that of the flood if the requests come faster than it reads them."""
    with served(path) as port, Viewer(port) as first, Viewer(port) as second:
        second.subscribe()
        second.until(lambda: second.shown("/image"))
        with suppress(*([] if pause_s else [ConnectionClosed])):
            for k in range(3000):
                first.request(f"seek {k}", play=k % 2 == 0, seek_ns=1000 * S + k * S // 100)
                time.sleep(pause_s)
        if pause_s:
            newest = first.until(lambda: [s for s in first.states() if s.request_id == "seek 2999"])
            assert newest[0].log_ns == 1000 * S + 2999 * S // 100
        assert second.control(play=False).status == "paused"


def test_a_viewer_after_the_end_gets_the_time_and_the_last_frame(path):
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


def test_the_server_stops_although_a_viewer_does_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(live_serving, "_STOP_S", 0.3)
    path, image = tmp_path / "large.mcap", CHANNELS[1]
    with log.LogWriter(path) as writer:
        for k in range(100):
            writer.write(log.Message(image, 1000 * S + k, 1000 * S + k, k, bytes(500_000)))
    serving = ExitStack()
    port = serving.enter_context(served(path))
    asleep = Viewer(port)
    asleep.subscribe()
    asleep.until(asleep.shown)  # it reads nothing from here on
    with Viewer(port) as awake:
        awake.subscribe()
        awake.until(lambda: [s for s in awake.states() if s.status == "ended"])
    ending = Thread(target=serving.close, daemon=True)
    ending.start()
    ending.join(PATIENCE_S)
    assert not ending.is_alive()
    asleep.socket.close_socket()


def test_a_loop_starts_a_new_session_with_new_channels(path):
    """Viewers without seek connect the last message to the next one, unless a new session drops the old messages.

    A new session also drops the schemas, so its channels are new.
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
        viewer.control(play=False)  # subscribe before the first message is due
        viewer.subscribe()
        viewer.until(lambda: len(viewer.shown()) == 2)
        assert {m.data for m in viewer.shown()} == {b"calibration", b"image 590"}
        viewer.control(play=True, rate=20.0)
        viewer.until(lambda: [s for s in viewer.states() if s.status == "ended"] and len(viewer.shown()) == 9)
        assert [m.data for m in viewer.shown()] == [b"image %d" % k for k in range(591, 600)]
        times = [item[0] for item in viewer.heard if len(item) == 1]
        assert 1059 * S <= times[0] < 1060 * S
        assert times == sorted(times)


@pytest.mark.parametrize(("host", "is_noted"), [("0.0.0.0", True), ("::", True), ("127.0.0.1", False), ("::1", False)])
def test_a_note_says_that_other_machines_can_connect(path, host, is_noted, capsys):
    with served(path, host=host):
        assert ("every machine" in capsys.readouterr().err) == is_noted


def test_other_addresses_connect_only_with_host(path):
    with served(path) as port, pytest.raises(ConnectionRefusedError):
        Viewer(port, "127.0.0.2")
    with served(path, host="0.0.0.0") as port, Viewer(port, "127.0.0.2") as viewer:
        assert viewer.channels


def test_the_error_names_a_port_in_use(path):
    with served(path) as port, pytest.raises(ServeError, match=rf"127\.0\.0\.1:{port}: .*in use.*--port 0"):
        serve_log(path, PlaybackOptions(port=port))


@pytest.mark.parametrize("start_s", [-1, 60])
def test_the_error_names_a_start_outside_the_log(path, start_s):
    with pytest.raises(LogError, match=r"--start .*expected 0 to 59\.900"):
        serve_log(path, PlaybackOptions(port=0, start_s=start_s))


FRAMES = 8
FIRST_NS = logs.START_NS


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return logs.write(tmp_path_factory.mktemp("live") / "in.mcap", logs.items(FRAMES))


@pytest.fixture(scope="module")
def replayed(source):
    replay(source, source.with_name("replayed.mcap"), load_config(None, ()))
    return source.with_name("replayed.mcap")


def sent_times(viewer):
    """Log time and milliseconds of each stage in the received messages."""
    found = [(m.log_time_ns, StageTimes.FromString(m.data)) for m in viewer.shown(TIMES_TOPIC)]
    return [(log_time_ns, *(getattr(times, name) for name in TIME_COLUMNS)) for log_time_ns, times in found]


def table_times(target):
    """The same from the table, with 0 for stages that did not run."""
    times = pl.read_parquet(sidecar_path(target, "metrics")).select("stamp_ns", pl.col(TIME_COLUMNS).fill_null(0.0))
    return times.rows()


@contextmanager
def replay_held_at(frame, source, target):
    """A replay in a thread that stops at a frame; yields its port and a function that lets it finish."""
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


def test_a_viewer_watches_and_seeks_in_a_running_replay(source, tmp_path):
    target, computed_ns = tmp_path / "out.mcap", FIRST_NS + 4 * STEP_NS
    with replay_held_at(5, source, target) as (port, finish), Viewer(port) as viewer:
        viewer.subscribe()
        viewer.until(lambda: any(s.status == "buffering" for s in viewer.states()))
        assert not target.exists()
        viewer.control(play=False)
        beyond = viewer.control(play=False, seek_ns=FIRST_NS + 7 * STEP_NS)
        assert (beyond.log_ns, beyond.moved) == (computed_ns - 1, True)
        assert re.match(r"the replay is 0\.\d s before", viewer.until(lambda: viewer.warnings)[0])
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
        assert sent_times(viewer) == table_times(target)


def test_a_finished_log_is_served_with_stage_times_of_its_table(replayed):
    assert log_with_times(replayed).channels[-1].topic == TIMES_TOPIC
    with served(replayed) as port, Viewer(port) as viewer:
        viewer.subscribe(TIMES_TOPIC)
        viewer.until(lambda: len(viewer.shown()) == FRAMES)
        assert sent_times(viewer) == table_times(replayed)
        viewer.control(play=False, seek_ns=FIRST_NS + 3 * STEP_NS)
        viewer.until(viewer.shown)
        assert sent_times(viewer) == table_times(replayed)[3:4]


@pytest.mark.parametrize("table", ["none", "another log's"])
def test_without_a_matching_table_no_stage_times_are_served(replayed, tmp_path, table):
    target, other = tmp_path / "out.mcap", tmp_path / "other.mcap"
    shutil.copy(replayed, target)
    if table != "none":
        replay(logs.write(tmp_path / "in2.mcap", logs.items(1)), other, load_config(None, ()))
        sidecar_path(other, "metrics").replace(sidecar_path(target, "metrics"))
    with served(target) as port, Viewer(port) as viewer:
        found = {channel["topic"] for channel in viewer.channels.values()}
        assert set(RESULTS) <= found
        assert TIMES_TOPIC not in found


def test_a_live_replay_writes_the_same_output(source, replayed, tmp_path):
    with LiveReplay(PlaybackOptions(port=0, rate=50.0), quiet=True) as live:
        replay(source, tmp_path / "live.mcap", load_config(None, ()), on_start=live.start, on_frame=live.times.note)
    assert (tmp_path / "live.mcap").read_bytes() == replayed.read_bytes()
    with pytest.raises((ConnectionError, WebSocketException)):  # refused, or closed by the ending server
        Viewer(live.port)


def test_a_replay_with_a_port_in_use_writes_nothing(source, tmp_path, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert replay_main([str(source), str(tmp_path / "out.mcap"), "--live", "--port", port]) == 1
    assert f"error: 127.0.0.1:{port}" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_wrong_live_options_are_a_usage_error(capsys):
    for options in ("--rate 2", "--loop", "--host ::1", "--port 0", "--live --rate 0", "--live --port 70000"):
        with pytest.raises(SystemExit) as ended:
            replay_main(["in.mcap", "out.mcap", *options.split()])
        assert ended.value.code == 2
        assert options.removeprefix("--live ").split()[0] in capsys.readouterr().err, options


@pytest.mark.parametrize(("command", "number"), [("serve", signal.SIGINT), ("replay", signal.SIGTERM)])
def test_a_signal_ends_the_server_without_error(source, tmp_path, command, number):
    target = tmp_path / "out.mcap"
    serving, replaying = ("roadperc-view", source, "--foxglove"), ("roadperc-replay", source, target, "--live")
    words = commands.words(*(serving if command == "serve" else replaying), "--port", 0)
    started = subprocess.Popen(words, stdout=-1, stderr=-1, text=True)
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
