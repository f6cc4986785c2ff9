"""Figures of known series, as text and as JSON."""

import json

import pytest

from roadperc_stream.tools.bench import __main__ as bench
from roadperc_stream.tools.bench.figures import SpeedFigure, figures, measured, median_of, noise, parts_of
from roadperc_stream.tools.bench.inputs import WARM_UP
from roadperc_stream.tools.bench.replays import Cost, a_frame

SERIES = {
    "control": [100.0, 110.0, 95.0],
    "course png/cpu": [400.0, 880.0, 420.0],
    "course png/wall": [400.0, 880.0, 420.0],
    "replay png, one thread/cpu": [50.0, 100.0, 60.0],
    "replay png, one thread/first frame/wall": [900.0, 1600.0, 700.0],
    "replay png, one thread/objects p95 over median": [3.0, 5.0, 3.5],
    "replay png, one thread/parts over total": [0.99, 0.98, 1.0],
    "replay png, one thread/part/decode": [10.0, 20.0, 11.0],
    "replay png, one thread/part/lanes": [7.0, 15.0, 8.0],
    "replay png, all threads/wall": [50.0, 60.0, 40.0],
    "--help/wall": [200.0, 330.0, 210.0],
    "import numpy, cv2/wall": [150.0, 300.0, 100.0],
}


def by_name(found):
    return {figure.name: figure for figure in found}


def test_figures_are_medians_of_the_rounds_ratios():
    found = by_name(figures(SERIES))
    assert found["png: course method over replay, cpu, one thread"].value == pytest.approx(8.0)
    assert found["png: course method over replay, cpu, one thread"].met is True
    assert found["png: course method over replay, wall, all threads"].value == pytest.approx(10.5)
    assert found["objects: p95 over median"].value == 3.5
    assert found["--help over import numpy, cv2, wall"].value == pytest.approx(200 / 150)
    assert found["first frame over import numpy, cv2, wall"].value == pytest.approx(6.0)


def test_missing_measurements_have_no_figure():
    assert not any("jpeg" in name or "stereo" in name for name in by_name(figures(SERIES)))


def test_bounds():
    assert SpeedFigure("", 1.0).met is None
    assert SpeedFigure("", 1.0, least=1.0, most=1.0).met is True
    assert SpeedFigure("", 0.9, least=1.0).met is False
    assert SpeedFigure("", 1.1, most=1.0).met is False
    assert SpeedFigure("", 1.0, 0.97, 1.03).wanted == "≥ 0.97, ≤ 1.03"


def test_the_time_per_frame_excludes_the_start():
    found = a_frame(Cost(1.5, 2.0, 100.0), Cost(3.5, 5.0, 200.0), WARM_UP + 10)
    assert found["cpu"] == pytest.approx(300.0)
    assert found["wall"] == pytest.approx(200.0)
    assert found["peak_mb"] == 200.0
    assert set(found) == {"cpu", "wall", "peak_mb"}


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


def test_parts_and_noise():
    assert parts_of(SERIES, "replay png, one thread") == {"decode": 11.0, "lanes": 8.0}
    assert noise(SERIES) == pytest.approx(0.15)


def test_it_prints_and_writes_all_figures(bench_logs, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bench, "logs_of", lambda _: bench_logs)
    monkeypatch.setattr(bench, "measured", lambda *_: SERIES)
    assert bench.main([str(tmp_path), "--frames", "4", "--json", str(tmp_path / "bench.json")]) == 0
    text = capsys.readouterr().out
    assert text.startswith("| run | cpu ms |")
    assert "| objects: p95 over median | 3.50 | met | ≤ 4 |" in text
    assert "noise of 15%." in text
    written = json.loads((tmp_path / "bench.json").read_text())
    assert written["series"] == SERIES
    assert written["frames"] == 4
    found = next(figure for figure in written["figures"] if figure["name"] == "objects: p95 over median")
    assert found == {"name": "objects: p95 over median", "value": 3.5, "least": None, "most": 4.0, "met": True}
