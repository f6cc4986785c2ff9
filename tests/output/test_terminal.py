"""Verdicts have a colour on a terminal only."""

import io

import pytest

from roadperc_stream.output.terminal import console_for, print_lines, print_table
from roadperc_stream.output.text_table import Table


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("stream", "environment", "coloured"),
    [(Terminal, {}, True), (Terminal, {"NO_COLOR": "1"}, False), (io.StringIO, {}, False)],
)
def test_a_verdict_is_coloured_on_a_terminal(monkeypatch, stream, environment, coloured):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    out = stream()
    print_lines(console_for(out), "worse: lane left error", "check: failed, 3 frames", "failed_run.mcap: 3 frames")
    print_table(console_for(out), Table("Metric", ("result",), [("failed frames", "worse")]))
    assert out.getvalue().count("\x1b[31m") == (3 if coloured else 0)
    assert out.getvalue().count("worse") == 2
