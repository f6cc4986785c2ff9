"""Whole replays of the sample with its messages delayed, its images late, and played twice."""

import random
from dataclasses import replace

import pytest

from roadperc_stream import log
from roadperc_stream.cli.replay import main
from roadperc_stream.config import load_config
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.system.time import TimeRange
from tests.resume import parts
from tests.resume.parts import write
from tests.test_sample import SAMPLE

FRAMES = 8


S, MS = 1_000_000_000, 1_000_000


S, MS = 1_000_000_000, 1_000_000


@pytest.fixture(scope="module")
def messages():
    """The input of the sample's first frames."""
    return list(
        open_input(ReplaySource(SAMPLE, time_range=TimeRange(frames=FRAMES)), load_config(None)).messages.copied()
    )


@pytest.fixture(scope="module")
def tidy(messages, tmp_path_factory):
    return replayed(tmp_path_factory.mktemp("tidy"), messages)


def replayed(folder, messages, *options):
    """Return the output of a log with these messages in log-time order."""
    assert main([str(write(folder / "in.mcap", messages)), str(folder / "out.mcap"), *options]) == 0
    return folder / "out.mcap"


def rows(output, table="metrics"):
    return parts.rows([output], table)


def results(output):
    """The results' topics and bytes, without their log times."""
    return [(topic, data) for frame in parts.results([output]).values() for topic, *_, data in frame]


def delayed(messages, by_ns):
    return [replace(m, log_time_ns=m.log_time_ns + by_ns(m)) for m in messages]


@pytest.mark.parametrize("seed", range(2))
def test_any_delays_up_to_the_wait_give_the_same_results(seed, messages, tidy, tmp_path):
    random_numbers = random.Random(seed)
    output = replayed(tmp_path, delayed(messages, lambda _: random_numbers.randrange(S)))
    assert rows(output).equals(rows(tidy))
    assert rows(output, "objects").equals(rows(tidy, "objects"))
    times = [m.log_time_ns for m in log.read(log.summarise(output))]
    assert times == sorted(times)
    assert results(output) == results(tidy)


def test_an_image_later_than_the_wait_is_dropped_and_reported(messages, tidy, tmp_path, capsys):
    stamps = rows(tidy)["stamp_ns"].to_list()
    late = delayed(messages, lambda m: 250 * MS * is_image(m, stamps[3]))
    output = replayed(tmp_path, late, "--set", "sync.max_wait_s=0.1")
    assert rows(output)["stamp_ns"].to_list() == [*stamps[:3], *stamps[4:]]
    assert rows(output)["odometry_status"].to_list()[1:] == ["tracked"] * (FRAMES - 2)
    said = capsys.readouterr().out
    (note,) = [line for line in said.splitlines() if "belong to no frame" in line]
    assert f"1 on /camera/front/image, stamp {stamps[3]} ns" in note
    assert f"/camera/front/image: message with stamp {stamps[3]} ns at log time" in said
    assert sum(is_image(m, stamps[3]) for m in log.read(log.summarise(output))) == 1  # it is copied all the same


def is_image(message, stamp_ns):
    """Whether a message is the image of a frame; the sample's log times are its stamps."""
    return message.channel.topic == "/camera/front/image" and message.publish_time_ns == stamp_ns
