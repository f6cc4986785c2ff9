"""Figures of known series, as text and as JSON."""

import json

import pytest

from roadperc_stream.tools.bench import __main__ as bench
from roadperc_stream.tools.bench.figures import SpeedFigure, figures, measured, median_of, noise
from roadperc_stream.tools.bench.inputs import WARM_UP
from roadperc_stream.tools.bench.replays import Cost, a_frame

SERIES = {
    "control": [100.0, 110.0, 95.0],
    "course png/cpu": [400.0, 880.0, 420.0],
    "replay png, one thread/cpu": [50.0, 100.0, 60.0],
    "replay png, one thread/objects p95 over median": [3.0, 5.0, 3.5],
    "replay png, one thread/part/decode": [10.0, 20.0, 11.0],
    "replay png, one thread/part/lanes": [7.0, 15.0, 8.0],
    "--help/wall": [200.0, 330.0, 210.0],
    "import numpy, cv2/wall": [150.0, 300.0, 100.0],
}


def test_figures_are_medians_of_the_rounds_ratios():
    assert {figure.name: value for figure, value in figures(SERIES)} == {
        "png: course method over replay, cpu, one thread": pytest.approx(8.0),
        "objects: p95 over median": 3.5,
        "--help over import numpy, cv2, wall": pytest.approx(200 / 150),
    }


def test_limits_include_their_ends():
    figure = SpeedFigure("", "", least=0.97, most=1.03)
    assert [figure.met(value) for value in (0.96, 0.97, 1.03, 1.04)] == ["missed", "met", "met", "missed"]
    assert figure.wanted == "≥ 0.97, ≤ 1.03"
    assert SpeedFigure("", "").met(1.0) == ""


def test_the_time_per_frame_excludes_the_start():
    found = a_frame(Cost(1.5, 2.0, 100.0), Cost(3.5, 5.0, 200.0), WARM_UP + 10)
    assert found == pytest.approx({"cpu": 300.0, "wall": 200.0, "peak_mb": 200.0})


def test_jobs_take_turns_with_the_control_before_each():
    order = []

    def job(name):
        return lambda: {"cpu": float(len(order))} if order.append(name) is None else {}

    series = measured({"a": job("a"), "b": job("b")}, 2)
    assert order == ["a", "b", "a", "b"]
    assert series["a/cpu"] == [1.0, 3.0]
    assert len(series["control"]) == 4
    assert min(series["control"]) > 0
    assert median_of(series, "b/cpu") == 3.0
    assert median_of(series, "c/cpu") is None
    assert noise(SERIES) == pytest.approx(0.15)


def test_it_prints_and_writes_all_figures(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bench, "logs_of", lambda _: {})
    monkeypatch.setattr(bench, "_jobs", lambda *_: {})
    monkeypatch.setattr(bench, "measured", lambda *_: SERIES)
    assert bench.main([str(tmp_path), "--frames", "4", "--json", str(tmp_path / "bench.json")]) == 0
    text = capsys.readouterr().out
    assert text.startswith("| run | cpu ms |")
    assert "| objects: p95 over median | 3.50 | met | ≤ 4 |" in text
    assert "| lanes | 8.0 |" in text
    assert "| total | 19.0 |" in text
    written = json.loads((tmp_path / "bench.json").read_text())
    assert (written["series"], written["frames"]) == (SERIES, 4)
    assert {"name": "objects: p95 over median", "value": 3.5, "wanted": "≤ 4", "met": "met"} in written["figures"]
