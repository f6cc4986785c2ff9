"""The settings as text, JSON, TOML and page: complete, and equal to the models."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from roadperc_stream.cli.replay import main
from roadperc_stream.cli.settings import as_page, as_text
from roadperc_stream.config import ReplayConfig, load_config
from roadperc_stream.config.catalogue import catalogue, sections
from roadperc_stream.errors import ConfigError
from roadperc_stream.schemas.topics import STAGES
from tests.config.test_settings import all_settings

ROOT = Path(__file__).parents[2]
BY_KEY = {setting.key: setting for setting in catalogue()}
WITHOUT_UNIT = {"seed"}
"""Numbers without a quantity."""


def printed(capsys, *arguments):
    assert main([*arguments]) == 0
    return capsys.readouterr().out


def refused(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main([*arguments])
    assert stopped.value.code == 2
    return capsys.readouterr().err.splitlines()[-1]


def test_every_setting_is_there_once_and_in_the_order_of_the_stages():
    assert sorted(BY_KEY) == sorted(all_settings())
    assert len(BY_KEY) == len(catalogue())
    assert list(sections()) == ["sync", *STAGES, "limits"]


@pytest.mark.parametrize("setting", catalogue(), ids=lambda setting: setting.key)
def test_every_setting_has_a_meaning_a_range_and_a_unit(setting):
    assert re.fullmatch(r"[A-Za-z].{10,}[.]", setting.meaning), setting
    assert "``" not in setting.meaning
    assert setting.range
    if setting.type in ("integer", "number") and setting.key not in WITHOUT_UNIT:
        assert setting.unit, setting
    is_text = setting.type == "string" and bool(setting.remark)
    assert bool(setting.choices) or is_text or {"minimum", "exclusiveMinimum"} & set(setting.limits)


@pytest.mark.parametrize("setting", [s for s in catalogue() if s.limits], ids=lambda setting: setting.key)
def test_the_limits_hold(setting):
    """Values just beyond a limit are refused, and the message names the setting."""
    step = 1 if setting.type == "integer" else 1e-9
    limits = setting.limits
    beyond = [limits[name] - step for name in ("minimum",) if name in limits]
    beyond += [limits[name] * (1 + 1e-9) + step for name in ("maximum",) if name in limits and setting.type == "number"]
    beyond += [limits[name] + step for name in ("maximum",) if name in limits and setting.type == "integer"]
    beyond += [limits[name] for name in ("exclusiveMinimum", "exclusiveMaximum") if name in limits]
    assert len(beyond) == 2
    for value in beyond:
        if str(int(value)) not in setting.choices:
            with pytest.raises(ConfigError, match=re.escape(setting.key)):
                load_config(None, (f"{setting.key}={int(value) if setting.type == 'integer' else value}",))


@pytest.mark.parametrize("setting", [s for s in catalogue() if s.choices], ids=lambda setting: setting.key)
def test_the_choices_are_accepted(setting):
    for choice in setting.choices:
        load_config(None, (f"{setting.key}={choice}",))


@pytest.mark.parametrize("width", [50, 80, 100])
def test_the_text_keeps_to_its_width(width):
    lines = as_text(width).splitlines()
    assert max(map(len, lines)) <= width
    assert all(any(f"{line} ".startswith(f"  {key} ") for line in lines) for key in BY_KEY)


def test_the_text_on_a_pipe_is_eighty_columns_wide():
    code = "import sys; from roadperc_stream.cli.replay import main; sys.exit(main())"
    plain = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    words = [sys.executable, "-c", code, "--list-settings"]
    said = subprocess.run(words, check=True, capture_output=True, text=True, timeout=60, env=plain).stdout
    assert said == as_text(80)
    assert "lanes.hold_s = 0.5  [s]  (0 to 3600)\n    How long an unseen boundary is held" in said


def test_json_has_the_same_facts(capsys):
    found = json.loads(printed(capsys, "--list-settings", "--json"))
    assert [item["key"] for item in found] == list(BY_KEY)
    (held,) = (item for item in found if item["key"] == "lanes.hold_s")
    assert held == {
        "key": "lanes.hold_s",
        "section": "lanes",
        "default": 0.5,
        "type": "number",
        "choices": [],
        "limits": {"minimum": 0.0, "maximum": 3600.0},
        "remark": "",
        "range": "0 to 3600",
        "unit": "s",
        "meaning": BY_KEY["lanes.hold_s"].meaning,
    }


def test_the_printed_configuration_is_the_default(capsys, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(printed(capsys, "--print-config"))
    assert load_config(path) == ReplayConfig()
    for setting in catalogue():
        assert re.search(rf"^# .*\n{setting.name} = ", path.read_text(), re.MULTILINE), setting.key


def test_the_printed_configuration_is_the_resolved_one(capsys, tmp_path):
    given = tmp_path / "given.toml"
    given.write_text('[lanes]\nhold_s = 0.2\nmodel = "line"\n')
    options = ["--config", str(given), "--set", "lanes.hold_s=0.8", "--set", "surface.classes=road", "--only", "lanes"]
    path = tmp_path / "mine.toml"
    path.write_text(printed(capsys, "--print-config", *options))
    cfg = load_config(path)
    assert (cfg.lanes.hold_s, cfg.lanes.model, cfg.surface.classes) == (0.8, "line", ("road",))
    assert (cfg.objects.enabled, cfg.surface.enabled, cfg.stereo.method) == (False, True, "off")
    assert "default 0.5" in path.read_text()
    written = tomllib.loads(path.read_text())
    assert ReplayConfig.model_validate(written) == cfg
    assert written["lanes"].keys() == type(cfg.lanes).model_fields.keys()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--list-settings", "in.mcap"], "IN.mcap cannot be combined with --list-settings"),
        (["--list-settings", "in.mcap", "out.mcap"], "IN.mcap cannot be combined with --list-settings"),
        (["--list-settings", "--set", "seed=1"], "--set cannot be combined with --list-settings"),
        (["--list-settings", "--print-config"], "--print-config cannot be combined with --list-settings"),
        (["--print-config", "--json"], "--json cannot be combined with --print-config"),
        (["--print-config", "--results-only"], "--results-only cannot be combined with --print-config"),
        (["--print-config", "--rate", "2"], "--rate cannot be combined with --print-config"),
        (["--json", "in.mcap", "out.mcap"], "--json needs --list-settings"),
        (["--json"], "the following arguments are required: IN.mcap, OUT.mcap"),
        (["in.mcap"], "the following arguments are required: OUT.mcap"),
    ],
)
def test_wrong_usage_is_one_clear_line(arguments, said, capsys):
    assert refused(capsys, *arguments) == f"roadperc-replay: error: {said}"


def test_the_page_is_up_to_date():
    """``make pages`` writes it."""
    assert (ROOT / "docs" / "settings.md").read_text("utf-8") == as_page()
