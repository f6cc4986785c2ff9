"""The committed sample: whole, small, and what its two commands make."""

import re
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadperc_stream import log
from roadperc_stream.cli import convert, render
from roadperc_stream.input.decoding import context_of_channel, decode
from roadperc_stream.model import CameraImage, DepthImage, TagImage
from roadperc_stream.schemas.roles import ROLES

ROOT = Path(__file__).parents[1]
SAMPLE = ROOT / "logs" / "sample.mcap"
LOCALLY_LEVELS = 5
"""By how much 9 by 9 pixels may differ in the mean: codecs round differently, and a line's edge may move a little."""
TOPICS = {role.topic: role for role in ROLES.values()}


def decoded(message):
    channel = message.channel
    context = context_of_channel(channel, "auto")
    role = TOPICS[channel.topic]
    args = (channel.schema_name, channel.message_encoding, message.data, message.log_time_ns, context)
    return decode(role.kind, *args).payload


@pytest.fixture(scope="module")
def remade(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sample")
    options = re.search(r"^SAMPLE_OPTIONS := (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE).group(1)
    assert render.main([str(folder / "dump"), *shlex.split(options)]) == 0
    assert convert.main([str(folder / "dump"), str(folder / "sample.mcap"), "--quiet"]) == 0
    return folder / "sample.mcap"


def test_it_holds_every_role_and_truth_in_few_bytes():
    summary = log.summarise(SAMPLE)
    counts = {c.topic: summary.counts[c.source_id] for c in summary.channels}
    absent = {role.topic for role in ROLES.values()} - set(counts)
    left = {"/camera/left/image", "/camera/left/calibration"}
    assert absent == left | {
        "/camera/front/depth/calibration",
        "/camera/front/instances",
        "/lidar/points",
        "/tf_static",
    }
    assert counts["/camera/front/image"] >= 40
    assert SAMPLE.stat().st_size < 8_000_000


@pytest.mark.long
def test_its_commands_make_it_again(remade):
    """Decoded content, for another version of a codec may pack the same pixels into other bytes."""
    old, new = list(log.read(log.summarise(SAMPLE))), list(log.read(log.summarise(remade)))
    assert [(m.channel.topic, m.log_time_ns) for m in old] == [(m.channel.topic, m.log_time_ns) for m in new]
    for a, b in zip(old, new, strict=True):
        assert alike(decoded(a), decoded(b)), f"{a.channel.topic} at {a.log_time_ns}"


def alike(a, b):
    if isinstance(a, CameraImage):
        difference = cv2.absdiff(a.bgr, b.bgr)
        return difference.mean() < 1.0 and cv2.blur(difference, (9, 9)).max() <= LOCALLY_LEVELS
    if isinstance(a, TagImage):
        return np.mean(a.tags == b.tags) > 0.999
    if isinstance(a, DepthImage):
        return np.mean(np.isclose(a.depth_m, b.depth_m, atol=0.0015, equal_nan=True)) > 0.999
    return numbers(a) == pytest.approx(numbers(b), abs=1e-5)


def numbers(payload):
    """Every number in the payload's repr, which shows all fields."""
    return [float(n) for n in re.findall(r"-?\d+\.?\d*(?:e[-+]\d+)?", repr(payload))]
