"""States from anybody: what no replay can have left is one line, in bounded time and memory, before it is made."""

import copy
import struct
import subprocess
import sys
import time
import zlib
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import zstandard

from roadperc_stream import log
from roadperc_stream.chain.stages.objects.rate_filter import RateFilter
from roadperc_stream.chain.stages.objects.template import Template
from roadperc_stream.chain.stages.objects.tracking import ObjectTrack
from roadperc_stream.core.config import load_config
from roadperc_stream.core.datatypes import Box, Detection
from roadperc_stream.errors import StateError
from roadperc_stream.log import Attachment
from roadperc_stream.schemas.record import BEGIN_ATTACHMENT, STATE_ATTACHMENT
from roadperc_stream.state import encoding
from roadperc_stream.state.attached import state_at_end
from tests import logs
from tests.replaying import replay
from tests.state.parts import cut, inputs, replayed, write

CFG = load_config(None, ("sync.max_wait_s=0.2",))
ROAD = replace(logs.SMALL, width=96, height=72)
MOST_MB, SLOWEST_S = 800, 6.0


MEASURED = """
import sys
from pathlib import Path
from roadperc_stream.core.config import load_config
from roadperc_stream.errors import StateError
from roadperc_stream.state.attached import state_at_end
try:
    state_at_end(Path(sys.argv[1]), load_config(None, ("sync.max_wait_s=0.2",)))
except StateError as error:
    print(error)
print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])  # ru_maxrss counts the parent too
"""


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    whole = logs.write(folder / "whole.mcap", logs.items(16, road=ROAD))
    messages = inputs(whole)
    return replayed(folder, cut(messages, [messages[0].log_time_ns + 500_000_000]), CFG)


def packed(state):
    data = zstandard.compress(msgspec.msgpack.encode(state))
    return encoding._MAGIC + bytes([encoding.FORMAT_VERSION]) + struct.pack("<I", zlib.crc32(data)) + data


def unpacked(path, name):
    (data,) = (item.data for item in log.summarise(path).attachments if item.name == name)
    return msgspec.msgpack.decode(encoding._unpacked(data[encoding._HEADER_BYTES :]))


def changed(source, target, name, change):
    """A copy of a result with another state; ``change`` alters it as MessagePack gives it."""
    state = copy.deepcopy(unpacked(source, name))
    change(state)
    with log.LogWriter(target) as writer:
        for message in log.read(log.summarise(source)):
            writer.write(message)
        for item in log.summarise(source).attachments:
            writer.attach(Attachment(item.name, item.media_type, packed(state) if item.name == name else item.data))
    return target


def grey(rows, columns):
    return {"dtype": "|u1", "shape": [rows, columns], "elements": bytes(rows * columns)}


def edges(tree, number):
    edge = next(iter(tree["edges"].values()))
    for k in range(number):
        tree["edges"][f"f{k}"] = {**edge, "parent": f"f{k - 1}" if k else "ego", "child": f"f{k}"}


def looped(state):
    tree = state["input"]["pairing"]["sync"]["latched"]["tree"]
    edge = next(iter(tree["edges"].values()))
    tree["edges"] |= {"a": {**edge, "parent": "b", "child": "a"}, "b": {**edge, "parent": "a", "child": "b"}}


def keyframe(state):
    return state["memory"]["chain"]["odometry"]["keyframe"]


def surface(state):
    return state["memory"]["chain"]["surface"]


def objects(state):
    return state["memory"]["chain"]["objects"]


def track(state):
    """One track, which is added: the drive's objects are too far away."""
    now_ns, rate = state["memory"]["chain"]["stamp_ns"], RateFilter(20.0, 0.0, 1.0, 0.0, 1.0)
    box = Box(10.0, 10.0, 30.0, 30.0)
    template = Template(np.zeros((20, 20), np.uint8), (0.0, 0.0), (20.0, 20.0), 10.0)
    times = (now_ns, now_ns, now_ns, now_ns)
    one = ObjectTrack(1, Detection("car", box, 0.9), box, rate, rate, rate, *times, template=template)
    added = msgspec.msgpack.decode(msgspec.msgpack.encode(one, enc_hook=encoding._encoded))
    objects(state).update(tracks=[added], next_number=2)
    return added


def test_a_state_with_a_track_is_read(parts, tmp_path):
    """Else the cases that follow would fail for another reason."""
    assert state_at_end(changed(parts[0], tmp_path / "a.mcap", STATE_ATTACHMENT, track), CFG)


def order(state):
    return state["input"]["pairing"]["order"]


def large_camera(state):
    for camera in state["input"]["pairing"]["sync"]["latched"]["cameras"].values():
        camera.update(width=40_000, height=40_000)


def many_tracks(state):
    one = track(state)
    objects(state).update(tracks=[{**one, "number": k + 1} for k in range(2000)], next_number=2001)


def large_tree(state):
    edges(state["input"]["arrived"], 300_000)


def long_tree(state):
    edges(state["input"]["arrived"], 3000)


def many_parents(state):
    state["input"]["parent_of"] = {str(k): "" for k in range(1_100_000)}


def parents(state):
    state["input"]["parent_of"] = {str(k): "x" for k in range(150_000)}


def twice(state):
    order(state)["waiting"] = [item for item in order(state)["waiting"] for _ in range(2)]


CASES = {
    "keyframe of one pixel": (lambda s: keyframe(s).update(grey=grey(1, 1)), "keyframe: expected uint8 (72, 96)"),
    "keyframe of 256 MB": (lambda s: keyframe(s).update(grey=grey(16_000, 16_000)), "array of 256000000 bytes: exp"),
    "landmarks": (lambda s: keyframe(s)["landmarks"]["features"].update(px=grey(1, 1)), "dtype"),
    "template of 400 MB": (lambda s: track(s)["template"].update(grey=grey(20_000, 20_000)), "array of 400000000 by"),
    "template of 1 MB": (lambda s: track(s)["template"].update(grey=grey(1000, 1000)), "template of 1000 x 1000"),
    "variance": (lambda s: track(s)["x_px"].update(value_var=-1.0), "a covariance that is none"),
    "far too large": (lambda s: track(s)["x_px"].update(value=1e200), "far too large"),
    "track of the future": (lambda s: track(s).update(stamp_ns=2**62), "a time out of its range"),
    "plane": (
        lambda s: surface(s).update(ego_plane={"normal": [0.0, 0.0, 2.0], "offset_m": 0.0}),
        "a plane that is none",
    ),
    "pose of one number": (
        lambda s: s["memory"]["shown"].update(trajectory=[{"dtype": "<f8", "shape": [1, 1], "elements": bytes(8)}]),
        "transform: expected float64 (4, 4), got float64 (1, 1)",
    ),
    "way driven": (lambda s: surface(s).update(driven_m=-1.0), "a plane that is none"),
    "2000 tracks": (many_tracks, "2000 tracks: expected 256 at most"),
    "next object 2^64 - 1": (lambda s: objects(s).update(next_number=2**64 - 1), "object 18446744073709551615"),
    "next object -1": (lambda s: objects(s).update(next_number=-1), "object -1"),
    "frame 2^32": (lambda s: s["input"]["numbers"].update(next=2**32), "frame 4294967296"),
    "camera": (large_camera, "of 40000 x 40000 pixels: expected limits.image_megapixels 40 at most"),
    "300000 transforms": (large_tree, "items, at most that many are read"),
    "3000 transforms": (long_tree, "expected limits.transforms 2000 at most"),
    "loop": (looped, "transforms that are no tree"),
    "a million parents": (many_parents, "items, at most that many are read"),
    "150000 parents": (parents, "parents of 150000 frames: expected 100000 at most, by limits.transforms"),
    "segment -5": (lambda s: order(s).update(segment=-5), "a segment out of its range"),
    "segment 2^40": (lambda s: order(s).update(segment=2**40), "a segment out of its range"),
    "segment of messages": (lambda s: s["input"]["pairing"]["sync"].update(segment=1), "a segment out of its range"),
    "tag table": (lambda s: s["input"].update(tag_table="\x1b[2Jfoo"), "tag table '\\x1b[2Jfoo'"),
    "role": (lambda s: s["input"]["topics"].update({"nothing": "/a"}), "roles nothing"),
    "twice": (twice, "a message that waits twice"),
    "stamp": (lambda s: order(s).update(latest_ns=-1), "a time out of its range"),
    "gaps": (lambda s: s.update(lost=[{"first_ns": 1, "last_ns": 2, "messages": {}}] * 20_000), "20000 gaps"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_state_beyond_the_limits_is_one_line(parts, tmp_path, case):
    change, expected = CASES[case]
    before = changed(parts[0], tmp_path / "before.mcap", STATE_ATTACHMENT, change)
    started_s = time.process_time()
    with pytest.raises(StateError) as caught:
        state_at_end(before, CFG)
    assert time.process_time() - started_s < SLOWEST_S
    assert expected in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_plain_replay_refuses_it_too(parts, tmp_path):
    source = changed(
        parts[1], tmp_path / "in.mcap", BEGIN_ATTACHMENT, lambda state: keyframe(state).update(grey=grey(1, 1))
    )
    with pytest.raises(StateError, match=r"attachment roadperc\.state\.begin: damaged: keyframe"):
        replay(source, tmp_path / "out.mcap", CFG)
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


@pytest.mark.parametrize("part", [0, 1])
def test_frames_that_have_no_number_left_are_refused_before_the_first(parts, tmp_path, part):
    """By ``--continue`` and by a plain replay of what began with it."""
    name = (STATE_ATTACHMENT, BEGIN_ATTACHMENT)[part]
    hostile = changed(parts[part], tmp_path / "in.mcap", name, lambda s: s["input"]["numbers"].update(next=2**32 - 3))
    source, continued = (parts[1], hostile) if part == 0 else (hostile, None)
    with pytest.raises(StateError, match=r"frame 4294967293 and \d+ more: a log numbers 4294967296 at most"):
        replay(source, tmp_path / "out.mcap", CFG, continued=continued)


def test_what_is_declared_is_not_made(parts, tmp_path):
    """400 MB of an array, which 1350 MB were used for."""
    path = changed(parts[0], tmp_path / "before.mcap", STATE_ATTACHMENT, CASES["template of 400 MB"][0])
    words = [sys.executable, "-c", MEASURED, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60)
    said, peak_kb = done.stdout.rsplit(maxsplit=1)
    assert "at most" in said
    assert int(peak_kb) < MOST_MB * 1024, peak_kb


def test_a_result_with_limits_of_its_own_is_continued_with_the_same(tmp_path, parts):
    """What one replay leaves within its limits the next one reads within them."""
    cfg = load_config(None, ("sync.max_wait_s=0.2", "limits.image_megapixels=0.01", "limits.transforms=1"))
    source = inputs(parts[0])
    made = replayed(tmp_path, cut(source, [source[0].log_time_ns + 300_000_000]), cfg)
    assert len(made) == 2
    with pytest.raises(StateError, match=r"limits\.image_megapixels was 0\.01, is 40"):
        replay(write(tmp_path / "x.mcap", source[-5:]), tmp_path / "y.mcap", CFG, continued=made[0])
