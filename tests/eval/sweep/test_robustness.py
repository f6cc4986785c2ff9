"""Sweeps over corruptions: Robo3D's rates by hand, and a whole sweep against single commands."""

import json
from xml.etree import ElementTree

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from roadperc_stream.cli import degrade
from roadperc_stream.cli.sweep import main
from roadperc_stream.config import ReplayConfig
from roadperc_stream.eval.sweep.combinations import degradations
from roadperc_stream.eval.sweep.ranking import SettingScore
from roadperc_stream.eval.sweep.robustness import robustness
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.columns import TIME_COLUMNS
from tests import logs
from tests.replaying import replay

MADE = degradations(ReplayConfig(), {"fog": (1, 2), "contrast": (5,)})


def scores(*values):
    return [SettingScore(value, 1.0) for value in values]


def test_the_rates_are_those_of_robo3d():
    found = robustness(scores(0.8, 0.6, 0.2, 0.4), MADE, scores(0.9, 0.7, 0.3, 0.7))
    assert found[0] == pytest.approx({"mean": 0.5, "fog": 0.8 / 1.6, "contrast": 0.5})
    assert found[1] == pytest.approx({"mean": (1.2 + 2) / 2, "fog": 1.2 / 1, "contrast": 0.6 / 0.3})


def test_frames_without_a_value_count_as_0():
    found = robustness([SettingScore(0.8, 0.5), *scores(0.2, 0.2, None)], MADE, None)
    assert found[0] == pytest.approx({"mean": 0.25, "fog": 0.5, "contrast": 0})
    assert found[1] == {}


def test_a_rate_without_a_denominator_is_undefined():
    found = robustness(scores(0, 0, 0, 0), MADE, scores(1, 1, 1, 0.5))
    assert found[0] == {"mean": None, "fog": None, "contrast": None}
    assert found[1] == {"mean": None, "fog": None, "contrast": 2}


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    logs.write(folder / "in.mcap", logs.items(4))
    assert sweep(folder, "base", "--set", "surface.inlier_m=0.2") == 0
    assert sweep(folder, "out", "--baseline", str(folder / "base"), "--json", str(folder / "out.json")) == 0
    return folder


def sweep(folder, name, *options):
    corruptions = ("--degrade", "depth_noise=5,1", "--degrade", "camera_crash=5", "--seed", "3")
    out = ("--out", str(folder / name), "--jobs", "1", *options)
    return main([str(folder / "in.mcap"), *corruptions, *out])


def test_rows_equal_those_of_a_replay_of_the_degraded_log(swept):
    copy = swept / "degraded.mcap"
    assert degrade.main([str(swept / "in.mcap"), str(copy), "--with", "depth_noise=5", "--seed", "3", "--quiet"]) == 0
    replay(copy, swept / "one.mcap", ReplayConfig())
    rows = pl.scan_parquet(f"{swept}/out/**/*.parquet").collect()
    own = rows.filter(pl.col("corruption") == "depth_noise", pl.col("severity") == 5)
    expected = pl.read_parquet(sidecar_path(swept / "one.mcap", "metrics"))
    assert_frame_equal(own.drop("corruption", "severity", *TIME_COLUMNS), expected.drop(TIME_COLUMNS), check_exact=True)
    assert rows.select("corruption", "severity").unique(maintain_order=True).rows() == [
        ("clean", 0),
        ("depth_noise", 1),
        ("depth_noise", 5),
        ("camera_crash", 5),
    ]
    assert not list(swept.glob("out/**/*.mcap"))


def test_another_folder_is_no_baseline(swept, capsys):
    assert sweep(swept, "new", "--baseline", str(swept)) == 1
    assert f"{swept}: degrade None, expected a sweep with" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([str(swept / "in.mcap"), "--vary", "seed=1,2", "--baseline", str(swept / "base")])
    assert "--baseline needs --degrade" in capsys.readouterr().err


def test_json_has_scores_and_rates_and_curves_are_svg(swept):
    values = json.loads((swept / "out.json").read_text())
    rates = values["robustness"]["lane left measured"]
    assert rates["rr"]["camera_crash"] < 1 == rates["rr"]["depth_noise"]
    assert set(rates["ce"]) == {"mean", "depth_noise", "camera_crash"}
    assert values["settings"]["0002"] == {"corruption": "depth_noise", "severity": 5}
    root = ElementTree.parse(swept / "out" / "curves.svg").getroot()
    assert "lane left measured" in [text.text for text in root.iter("{http://www.w3.org/2000/svg}text")]
