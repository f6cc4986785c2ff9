"""The frames of a continued log are those of the whole log, for any cut and any lateness."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream import log
from roadperc_stream.config import load_config
from roadperc_stream.geometry import rigid
from roadperc_stream.input import ReplaySource, input_of
from roadperc_stream.input.source import ReadableLog
from roadperc_stream.input.window import LeadIn
from roadperc_stream.model import Transform
from roadperc_stream.output import encoding
from tests import logs
from tests.analytic import STEP_NS
from tests.resume.parts import cut, write

CFG = load_config(None, ("sync.max_wait_s=0.3", "sync.tolerance_s=0.02"))
WAIT_NS = 300_000_000
FRAMES = 24
TINY = replace(logs.SMALL, width=16, height=12)


def drive():
    """A log with a new pose in each frame and one change of the camera; all roles from the start."""
    made = list(logs.items(2, road=TINY))
    blueprint = {item.role: item for item in made}
    found = [item for item in made if item.role == "calibration"]
    for k in range(FRAMES):
        stamp = logs.START_NS + k * STEP_NS
        edge = Transform("map", "ego", rigid(np.eye(3), np.array([float(k), 0.0, 0.0])))
        found.append(logs.Item("tf", stamp, encoding.encode_transforms(stamp, [edge])))
        if k == 0:
            found.append(logs.Item("tf", stamp, blueprint["tf"].data))
        if k == FRAMES // 2:
            other = replace(TINY, width=32).camera
            found.append(logs.Item("calibration", stamp, encoding.encode_calibration(stamp, replace(other, width=16))))
        found += logs.frame_items(stamp, TINY)
    return [
        log.Message(logs.channel(item.role), item.stamp_ns, item.stamp_ns, number, item.data)
        for number, item in enumerate(found)
    ]


DRIVE = drive()
LATCHED = ("/camera/front/calibration", "/tf")


def seen(sample):
    """The facts of a sample that depend on its messages."""
    frame = sample.frame
    parts = (frame.image, frame.depth_image, frame.segmentation, frame.detections)
    places = tuple(None if place is None else place.tobytes() for place in (frame.ego_T_camera, frame.ego_T_left))
    return (
        sample.index,
        sample.log_time_ns,
        frame.stamp_ns,
        frame.camera,
        places,
        sample.missing,
        sample.skew_ns,
        sample.segment,
        sample.anchor.frame_id,
        sample.anchor.odom,
        tuple(part is not None for part in parts),
    )


def frames(path, before=None):
    """The frames of a log, and what a later log continues: the log, and its last complete frame."""
    summary, lead = log.summarise(path), None
    if before is not None:
        earlier, last = before
        lead = LeadIn(earlier, last.since_ns if last else 0, earlier.last_ns + 1, continues=True, last=last)
    log_in = input_of(ReadableLog(summary), ReplaySource(path), CFG, lead)
    samples = list(log_in.samples())
    last = next((s.settled for s in reversed(samples) if s.settled), lead.last if lead else None)
    with log.LogWriter(path.with_suffix(".copy")) as writer:
        for message in log_in.messages.copied():
            writer.write(message)
    return {sample.index: seen(sample) for sample in samples}, (log.summarise(path.with_suffix(".copy")), last)


def in_parts(folder, parts):
    found, before = {}, None
    for k, messages in enumerate(part for part in parts if part):
        new, before = frames(write(folder / f"{k}.mcap", messages), before)
        found |= new
    return found


def arriving(delays_ns, lost=frozenset()):
    kept = [(m, d) for k, (m, d) in enumerate(zip(DRIVE, delays_ns, strict=True)) if k not in lost]
    late = [replace(m, log_time_ns=m.log_time_ns + d * (m.channel.topic not in LATCHED)) for m, d in kept]
    return sorted(late, key=lambda m: m.log_time_ns)


def edges_after_all_roles(messages):
    first = {}
    for message in messages:
        first.setdefault(message.channel.topic, message.log_time_ns)
    return max(first.values()) + 1, messages[-1].log_time_ns


@settings(max_examples=12)
@given(st.data())
def test_a_log_cut_anywhere_gives_the_frames_of_the_whole(data):
    delays = data.draw(st.lists(st.integers(0, WAIT_NS), min_size=len(DRIVE), max_size=len(DRIVE)))
    lost = data.draw(st.frozensets(st.integers(8, len(DRIVE) - 1), max_size=30))
    messages = arriving(delays, lost)
    cuts = data.draw(st.lists(st.integers(*edges_after_all_roles(messages)), min_size=1, max_size=6))
    with TemporaryDirectory() as folder:
        whole, _ = frames(write(Path(folder) / "whole.mcap", messages))
        assert in_parts(Path(folder), cut(messages, cuts)) == whole


@pytest.mark.parametrize("number", [1, 4, 7])
def test_a_cut_between_an_image_and_its_depth(tmp_path, number):
    """The first part gives an incomplete frame; the second repeats it completely."""
    messages = arriving([0] * len(DRIVE))
    image = [k for k, m in enumerate(messages) if m.channel.topic == "/camera/front/image"][number]
    first, end = frames(write(tmp_path / "0.mcap", messages[: image + 1]))
    assert first[number][5] == ("depth", "segmentation", "detections")
    again, _ = frames(write(tmp_path / "1.mcap", messages[image + 1 :]), end)
    whole, _ = frames(write(tmp_path / "whole.mcap", messages))
    assert first | again == whole


def test_logs_without_a_new_frame_are_continued(tmp_path):
    messages = arriving([0] * len(DRIVE))
    at = edges_after_all_roles(messages)[0]
    parts = cut(messages, [at + k * STEP_NS // 3 for k in range(3 * FRAMES)])
    assert len([part for part in parts if part]) > FRAMES - 2
    whole, _ = frames(write(tmp_path / "whole.mcap", messages))
    assert in_parts(tmp_path, parts) == whole


def test_a_cut_at_a_new_segment(tmp_path):
    """The stamps start again; the first two images wait for a third."""
    later = [replace(m, log_time_ns=m.log_time_ns + (FRAMES + 4) * STEP_NS) for m in DRIVE]
    messages = [*DRIVE, *later]
    whole, _ = frames(write(tmp_path / "whole.mcap", messages))
    assert {row[7] for row in whole.values()} == {0, 1}
    for step in (-1, 1, 3, 5):
        assert in_parts(tmp_path, cut(messages, [later[0].log_time_ns + step * STEP_NS // 2])) == whole


def test_a_later_log_reads_only_the_last_messages_again(tmp_path):
    _, (earlier, last) = frames(write(tmp_path / "0.mcap", arriving([0] * len(DRIVE))))
    assert earlier.last_ns - last.since_ns <= WAIT_NS + 2 * STEP_NS
