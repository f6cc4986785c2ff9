"""The README shows what the demo prints, its example runs, and the commands it names exist."""

import re
import shutil
from pathlib import Path

import pytest

from roadperc_stream.cli.replay import replay_main
from roadperc_stream.eval import report
from roadperc_stream.output.tables import sidecar_path

ROOT = Path(__file__).parents[1]
WITHOUT_TIMES = "How fast?"


def shown():
    block = re.search(r"```text\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    return block.group(1)


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The sample, replayed once for all tests."""
    target = tmp_path_factory.mktemp("demo") / "sample.mcap"
    assert replay_main([str(ROOT / "logs" / "sample.mcap"), str(target), "--quiet"]) == 0
    return target


def test_the_readme_shows_what_the_demo_prints(demo, capsys):
    assert report.main([str(sidecar_path(demo, "metrics"))]) == 0
    printed, _, rest = capsys.readouterr().out.partition(WITHOUT_TIMES)
    assert words(shown().partition(WITHOUT_TIMES)[0]) == words(printed)
    assert numbers(shown().partition(WITHOUT_TIMES)[0]) == pytest.approx(numbers(printed), rel=0.02, abs=0.002)
    assert "Worst frames" in rest


def test_the_readme_asks_the_table(demo, tmp_path, monkeypatch, capsys):
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    shutil.copy(sidecar_path(demo, "metrics"), tmp_path / "out.metrics.parquet")
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert re.search(r"│ depth +┆ 40 +┆ 0\.[4-9]\d* +┆ 1\.0 ", printed), printed
    assert float(re.search(r"precision (\S+)", printed).group(1)) == pytest.approx(0.76, abs=0.02)


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
