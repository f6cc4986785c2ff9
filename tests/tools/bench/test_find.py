"""The benchmark's dataset has its events, and the benchmark measures both conditions."""

import re

from roadperc_stream.cli import find
from roadperc_stream.tools.bench.find import IMPACT, NEAR, main, write_dataset


def test_every_hundredth_log_has_an_event(tmp_path, capsys):
    write_dataset(tmp_path, 101, 60)
    for condition in (IMPACT, NEAR):
        assert find.main([str(tmp_path), condition]) == 0
        first, _, *events = capsys.readouterr().out.splitlines()
        assert first == f"2 events in 2 logs: {condition}"
        assert [line.split()[:3] for line in events] == [["log00000", "21", "39"], ["log00100", "21", "39"]]


def test_it_prints_time_and_memory(tmp_path, capsys):
    assert main([str(tmp_path), "--logs", "1", "--frames", "60"]) == 0
    assert len(re.findall(r" +\d+\.\d +\d+\.\d +\d+$", capsys.readouterr().out, re.MULTILINE)) == 2
