"""README and docs are true: all commands and examples run, in order, in one folder, and print the shown output.

Commands in fences of ``bash``, not ``sh``, need recordings that the folder does not have; they do not run.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import polars as pl
import pytest

from roadperc_stream import log
from tests.commands import run_forked

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    *(ROOT / f"docs/{name}.md" for name in ("viewing", "recordings", "chain", "own_stage", "degrade", "evaluation")),
]
"""Pages whose commands run, in the order in which a reader meets them."""
TEXTS = [
    *(ROOT / f"{name}.md" for name in ("README", "CHANGELOG", "CONTRIBUTING")),
    *sorted((ROOT / "docs").glob("*.md")),
]
FENCE = re.compile(r'^```(sh|python)(?: title="(\S+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
EXAMPLES = [text for *_, text in FENCE.findall((ROOT / "docs" / "python.md").read_text(encoding="utf-8"))]
SERVES = re.compile(r"--(foxglove|live)$")
OPENS_VIEWER = re.compile(r"^roadperc-view \S+$")
PYTHON = shlex.quote(sys.executable)
OR_TRUE = " || true"
BENCHES = ("bench", "bench.compare")
OTHERS = {"--delta_unit", "--all_pairs", "--shell", "--max-bag-duration", "--inplace"} | {
    "--head", "--address", "--num-cpus", "--block", "--port", "--generate", "--dashboard-host",
    "--sett", "--force-regen", "--rm", "--init", "--network", "--env", "--volume", "--shm-size", "--detach",
}  # fmt: skip
"""Options of evo, argcomplete, rosbag2, setuptools, Ray, pytest and containers, and a misspelled one, on the pages."""


@dataclass(frozen=True)
class Block:
    page: str
    language: str
    title: str
    text: str

    def lines(self):
        return [bare for line in self.text.splitlines() if (bare := re.sub(r"(^|\s+)# .*", "", line).strip())]


def blocks():
    return [Block(page.name, *found) for page in PAGES for found in FENCE.findall(page.read_text(encoding="utf-8"))]


def readers_folder(folder, seconds):
    """A reader's folder after ``make demo`` with the first seconds of the sample."""
    (folder / "logs" / "runs" / "demo").mkdir(parents=True)
    shutil.copy(ROOT / "logs" / "sample.mcap", folder / "logs")
    shorten(folder / "logs" / "sample.mcap", seconds)
    run("roadperc-replay logs/sample.mcap logs/runs/demo/sample.mcap --quiet", folder)
    return folder


def shorten(path, seconds):
    """Keep the first seconds of a log, to save time."""
    whole = log.summarise(path)
    messages = list(log.read(whole, end_ns=whole.first_ns + round(seconds * 1e9)))
    with log.LogWriter(path) as writer:
        for message in messages:
            writer.write(message)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The report of the whole sample."""
    folder = readers_folder(tmp_path_factory.mktemp("reader"), 9)
    return run("roadperc-report logs/runs/demo/sample.mcap", folder).splitlines()


def environment():
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def run(command, folder):
    """What a command prints; only shell syntax needs a shell."""
    bare = command.removesuffix(OR_TRUE)
    if re.fullmatch(r"roadperc-[^|&;*$()<>]+", bare):
        ended = run_forked(*shlex.split(bare), cwd=folder)
    else:
        ended = subprocess.run(
            ["bash", "-c", command],
            cwd=folder,
            env=environment(),
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    assert ended.returncode in ((0, 1) if command != bare else (0,)), (
        f"{command}\n{ended.stdout[-2000:]}\n{ended.stderr[-2000:]}"
    )
    return ended.stdout


def serve(command, folder):
    """Run a server command: it must print its address and end on SIGINT."""
    served = subprocess.Popen(
        ["bash", "-c", f"exec {command} --port 0"], cwd=folder, env=environment(), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    try:
        printed = served.stdout.readline()
        while printed and "ws://" not in printed:
            printed = served.stdout.readline()
        assert "ws://127.0.0.1:" in printed, command
    finally:
        served.send_signal(signal.SIGINT)
        served.communicate(timeout=60)


COMPARISON = "roadperc-compare out.mcap other.mcap || true"
CHECK = "roadperc-check out.mcap"


@pytest.mark.long
def test_every_command_runs_in_order(tmp_path):
    """The comparison and the check of README need all frames; then the logs are shortened, to save time."""
    folder = readers_folder(tmp_path, 0.3)
    shown = None
    for block in blocks():
        if block.language == "python":
            name = block.title or "block.py"
            (folder / name).write_text(block.text, encoding="utf-8")
            run(f"{PYTHON} {name}", folder)
            continue
        for line in block.lines():
            if SERVES.search(line):
                serve(line, folder)
            elif OPENS_VIEWER.match(line):
                run(f"{line} --save viewed.rrd --force", folder)
            elif (line, shown) == (COMPARISON, None):
                shown = run(line, folder).splitlines()
            elif line == CHECK:
                run(line, folder)
                shorten(folder / "in.mcap", 0.3)
                run("roadperc-replay in.mcap out.mcap --force", folder)
                run("roadperc-replay in.mcap other.mcap --set surface.inlier_m=0.5 --force", folder)
            else:
                run(line, folder)
    page = (ROOT / "docs" / "evaluation.md").read_text(encoding="utf-8")
    for line in re.search(r"```text\n((?:worse|better): .*?)```", page, re.DOTALL).group(1).splitlines():
        match = next((other for other in shown if words(other) == words(line)), "")
        assert numbers(line) == pytest.approx(numbers(match), rel=0.02), line


@pytest.mark.parametrize("code", EXAMPLES, ids=lambda code: code.partition("\n")[0])
def test_every_python_example_runs(code, tmp_path):
    (tmp_path / "logs").mkdir()
    shutil.copy(ROOT / "logs" / "sample.mcap", tmp_path / "logs")
    shorten(tmp_path / "logs" / "sample.mcap", 0.5)
    (tmp_path / "example.py").write_text(code, encoding="utf-8")
    run(f"{PYTHON} example.py", tmp_path)


def test_type_checkers_see_what_the_examples_import():
    """Of a package with types, ``from a import b`` in its ``__init__`` is private; ``import b as b`` is public."""
    sources = [text for page in TEXTS for *_, text in FENCE.findall(page.read_text(encoding="utf-8"))]
    found = [re.findall(r"^from (roadperc_stream\.\w+) import (.+)$", text, re.MULTILINE) for text in sources]
    imports = [(package, name) for of_one in found for package, names in of_one for name in names.split(", ")]
    assert imports
    for package, name in imports:
        init = ROOT / package.replace(".", "/") / "__init__.py"
        assert f" import {name} as {name}\n" in init.read_text(encoding="utf-8"), (package, name)


@pytest.mark.parametrize("page", ["README.md", "docs/evaluation.md"])
def test_the_pages_show_lines_of_the_report(report, page):
    printed = report
    text = (ROOT / page).read_text(encoding="utf-8")
    shown = [line for line in re.search(r"```text\n(.*?)```", text, re.DOTALL).group(1).splitlines() if line]
    assert len(shown) >= 8
    for line in shown:
        match = next((other for other in printed if words(other) == words(line)), None)
        assert match is not None, line
        assert numbers(line) == pytest.approx(numbers(match), rel=0.02, abs=0.002), line
        printed = printed[printed.index(match) + 1 :]


def words(text):
    """The words of a text without numbers and rules."""
    return re.sub(r"-?\d+(\.\d+)?|─+", "", text).split()


def numbers(text):
    return [float(n) for n in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w.])", text)]


def test_every_command_and_option_of_the_pages_exists():
    scripts = set(re.findall(r"^(roadperc-[a-z]+) = ", (ROOT / "pyproject.toml").read_text(), re.MULTILINE))
    named = {
        command for page in TEXTS for command in re.findall(r"\broadperc-[a-z]+", page.read_text(encoding="utf-8"))
    }
    assert named <= scripts
    assert scripts <= named
    programs = [*sorted(scripts), *(f"{PYTHON} -m roadperc_stream.tools.{name}" for name in BENCHES)]
    helps = "".join(run(f"{program} --help", ROOT) for program in programs)
    options = {
        o for page in TEXTS for o in re.findall(r"(?<![\w-])--[a-z][a-z_-]*[a-z]", page.read_text(encoding="utf-8"))
    }
    assert {option for option in options - OTHERS if option not in helps} == set()


def test_every_make_target_of_the_pages_exists():
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {
        t for page in TEXTS for t in re.findall(r"(?:^    |`)make ([a-z-]+)", page.read_text("utf-8"), re.MULTILINE)
    }
    assert named <= targets


def test_every_link_has_a_target():
    for page in TEXTS:
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_tests_of_the_reliability_page_exist():
    named = set(re.findall(r"`(tests/[^`]+)`", (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8")))
    assert len(named) > 5
    assert [name for name in named if not (ROOT / name).exists()] == []


LONGEST_SENTENCE = 30
"""Words. Text in backticks is one word."""
UNCLEAR = re.compile(
    r"\b(?:that is none|is none|are none|nobody|anew|stands? (?:in|at|beside|for itself)|but for|told|is said|says so|"
    r"whatever|meanwhile|the way|by itself|lest|that one|all that|so far|such a one|of its own|of one's own|"
    r"held against|is had|came of|heed|welcome|whereabouts|Sight)\b"
)
"""Phrases that a reader of English as a second language has to read twice."""


def prose(markdown):
    """The text of a page without code blocks, headings and comments; each cell of a table is a paragraph."""
    for line in re.sub(r"```.*?```", "\n", markdown, flags=re.DOTALL).splitlines():
        bare = line.strip()
        if bare.startswith("|"):
            yield from ("", *(cell.strip() + "\n" for cell in bare.strip("|").split("|")))
        else:
            yield "" if bare.startswith(("<!--", "#")) or line.startswith("    ") else line


def sentences(markdown):
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", "\n".join(prose(markdown)))
    parts = re.split(r"(?<=[.!?])\s+|\n\s*\n|\n[-*] |\n\d+\. ", re.sub(r"`[^`]*`", "CODE", text))
    return [part.split() for part in parts]


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: page.name)
def test_every_sentence_is_short_and_clear(page):
    text = page.read_text(encoding="utf-8")
    assert [" ".join(words) for words in sentences(text) if len(words) > LONGEST_SENTENCE] == []
    assert UNCLEAR.findall(text) == []


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 130


@pytest.mark.parametrize(("first", "second"), ["ab", "ba"])
def test_the_example_of_a_dataset_reads_tables_of_several_versions_in_any_order(tmp_path, first, second):
    """A version without a column writes a table before or after one with it."""
    (code,) = [text for *_, text in FENCE.findall((ROOT / "docs/evaluation.md").read_text()) if "runs.parquet" in text]
    folder = tmp_path / "dataset" / "metrics" / "date=2020-01-01"
    folder.mkdir(parents=True)
    rows = pl.DataFrame({"log_id": ["x", "x"], "config": ["c", "c"], "lane_left_error_m": [0.25, -0.75]})
    rows.write_parquet(folder / f"{first}.parquet")
    rows.drop("lane_left_error_m").with_columns(log_id=pl.lit("y")).write_parquet(folder / f"{second}.parquet")
    runs = pl.DataFrame({"log_id": ["x", "y"], "config": ["c", "c"], "path": ["p", "q"], "settings": ["", ""]})
    runs.write_parquet(tmp_path / "dataset" / "runs.parquet")
    (tmp_path / "example.py").write_text(code)
    assert re.search(r"x +┆ c +┆ 0\.5 ", run(f"{PYTHON} example.py", tmp_path))
