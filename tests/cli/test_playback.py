"""The options of playback: what is given, and what holds where nothing is."""

import argparse

import pytest

from roadperc_stream.cli.arguments import (
    add_playback_arguments,
    add_serving_arguments,
    given_options,
    playback_options,
    serving_options,
)
from roadperc_stream.view.live import PlaybackOptions


def parsed(add, *arguments):
    parser = argparse.ArgumentParser()
    add(parser)
    return parser.parse_args(arguments)


def test_nothing_given():
    assert playback_options(parsed(add_playback_arguments)) == PlaybackOptions(1.0, False, "127.0.0.1", 8765, 0.0)
    assert given_options(parsed(add_serving_arguments)) == []


def test_all_given():
    given = ("--rate", "0.5", "--loop", "--host", "::1", "--port", "0", "--start", "12.5")
    arguments = parsed(add_playback_arguments, *given)
    assert playback_options(arguments) == PlaybackOptions(0.5, True, "::1", 0, 12.5)
    assert serving_options(arguments) == PlaybackOptions(0.5, True, "::1", 0)
    assert given_options(arguments) == ["rate", "loop", "host", "port"]


@pytest.mark.parametrize(
    "wrong",
    [("--rate", "0"), ("--rate", "-1"), ("--rate", "nan"), ("--rate", "x"), ("--port", "-1"), ("--start", "inf")],
)
def test_numbers_that_make_no_sense(wrong, capsys):
    with pytest.raises(SystemExit):
        parsed(add_playback_arguments, *wrong)
    assert wrong[0] in capsys.readouterr().err
