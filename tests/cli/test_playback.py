"""The options of serving: what is given, and what holds where nothing is."""

import argparse

import pytest

from roadperc_stream.cli.arguments import add_serving_arguments, given_options, serving_options
from roadperc_stream.view.live import PlaybackOptions


def parsed(*arguments):
    parser = argparse.ArgumentParser()
    add_serving_arguments(parser)
    return parser.parse_args(arguments)


def test_nothing_given():
    assert serving_options(parsed()) == PlaybackOptions(1.0, False, "127.0.0.1", 8765, 0.0)
    assert given_options(parsed()) == []


def test_all_given():
    arguments = parsed("--rate", "0.5", "--loop", "--host", "::1", "--port", "0")
    assert serving_options(arguments) == PlaybackOptions(0.5, True, "::1", 0)
    assert given_options(arguments) == ["rate", "loop", "host", "port"]


@pytest.mark.parametrize("wrong", ["--rate=0", "--rate=-1", "--rate=nan", "--rate=x", "--port=-1"])
def test_numbers_that_make_no_sense(wrong, capsys):
    with pytest.raises(SystemExit):
        parsed(wrong)
    assert wrong.partition("=")[0] in capsys.readouterr().err
