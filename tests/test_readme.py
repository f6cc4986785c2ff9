"""The README's table is what the demo prints."""

import re
from pathlib import Path

import pytest

from roadperc_stream.cli import replay_main
from roadperc_stream.eval import report
from roadperc_stream.table import beside

ROOT = Path(__file__).parents[1]
WITHOUT_TIMES = "How fast?"


def shown():
    block = re.search(r"```text\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    return block.group(1)


def test_the_readme_shows_what_the_demo_prints(tmp_path, capsys):
    target = tmp_path / "sample.mcap"
    assert replay_main([str(ROOT / "logs" / "sample.mcap"), str(target), "--quiet"]) == 0
    assert report.main([str(beside(target, "metrics"))]) == 0
    printed, _, rest = capsys.readouterr().out.partition(WITHOUT_TIMES)
    assert words(shown().partition(WITHOUT_TIMES)[0]) == words(printed)
    assert numbers(shown().partition(WITHOUT_TIMES)[0]) == pytest.approx(numbers(printed), rel=0.02, abs=0.002)
    assert "Worst frames" in rest


def words(text):
    """Everything but numbers and the lengths of rules; version and configuration change with every release."""
    text = re.sub(r"configuration \w+, version \S+", "", text)
    return re.sub(r"-?\d+(\.\d+)?|─+", "", text).split()


def numbers(text):
    return [float(n) for n in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w.])", text.partition("\n")[2])]


def test_every_command_the_readme_names_exists():
    commands = set(re.findall(r"\broadperc-[a-z]+", (ROOT / "README.md").read_text()))
    scripts = set(re.findall(r"^(roadperc-[a-z]+) = ", (ROOT / "pyproject.toml").read_text(), re.MULTILINE))
    assert commands <= scripts
    assert {"roadperc-convert", "roadperc-render", "roadperc-replay", "roadperc-report"} <= commands
