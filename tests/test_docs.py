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
from pathlib import Path

import polars as pl
import pytest

from roadperc_stream import log
from tests.commands import run_forked

ROOT = Path(__file__).parents[1]
TEXTS = {
    path.name: path.read_text(encoding="utf-8")
    for path in (*(ROOT / f"{name}.md" for name in ("README", "CHANGELOG", "CONTRIBUTING")), *ROOT.glob("docs/*.md"))
}
RUN = ("README", "viewing", "recordings", "chain", "own_stage", "degrade", "evaluation")
"""Pages whose commands run, in the order in which a reader meets them."""
FENCE = re.compile(r'^```(sh|python)(?: title="(\S+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
EXAMPLES = [text for *_, text in FENCE.findall(TEXTS["python.md"])]
SERVES = re.compile(r"--(foxglove|live)$")
OPENS_VIEWER = re.compile(r"^roadperc-view \S+$")
PYTHON = shlex.quote(sys.executable)
OR_TRUE = " || true"
COMPARISON = "roadperc-compare out.mcap other.mcap || true"
CHECK = "roadperc-check out.mcap"
BENCHES = ("bench", "bench.compare")
OTHERS = {
    "--delta_unit", "--all_pairs", "--shell", "--inplace", "--head", "--address", "--force-regen",
    "--rm", "--env", "--volume", "--detach", "--jq", "--method", "--paginate", "--silent",
}  # fmt: skip
"""Options of evo, argcomplete, setuptools, Ray, pytest, containers and GitHub's gh on the pages."""
LONGEST_SENTENCE = 30
"""Words."""


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


def environment():
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def run(command, folder):
    """What a command prints; only shell syntax needs a shell."""
    bare = command.removesuffix(OR_TRUE)
    if re.fullmatch(r"roadperc-[^|&;*$()<>]+", bare):
        ended = run_forked(*shlex.split(bare), cwd=folder)
    else:
        shell = ["bash", "-c", command]
        ended = subprocess.run(
            shell, cwd=folder, env=environment(), capture_output=True, text=True, timeout=300, check=False
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


@pytest.mark.long
def test_every_command_runs_in_order(tmp_path):
    """The comparison and the check of README need all frames; then the logs are shortened, to save time."""
    folder = readers_folder(tmp_path, 0.3)
    shown = None
    for language, title, text in (block for name in RUN for block in FENCE.findall(TEXTS[f"{name}.md"])):
        if language == "python":
            (folder / (title or "block.py")).write_text(text, encoding="utf-8")
            run(f"{PYTHON} {title or 'block.py'}", folder)
            continue
        for line in filter(None, (re.sub(r"(^|\s+)# .*", "", line).strip() for line in text.splitlines())):
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
                run("roadperc-replay in.mcap other.mcap --set objects.distance_quantile=0.5 --force", folder)
            else:
                run(line, folder)
    on_page = re.search(r"```text\n((?:worse|better): .*?)```", TEXTS["evaluation.md"], re.DOTALL)[1]
    for line in on_page.splitlines():
        match = next((other for other in shown if words(other) == words(line)), "")
        assert numbers(line) == pytest.approx(numbers(match), rel=0.02), line


@pytest.mark.parametrize("code", EXAMPLES, ids=lambda code: code.partition("\n")[0])
def test_every_python_example_runs(code, tmp_path):
    (tmp_path / "logs").mkdir()
    shutil.copy(ROOT / "logs" / "sample.mcap", tmp_path / "logs")
    shorten(tmp_path / "logs" / "sample.mcap", 0.5)
    (tmp_path / "example.py").write_text(code, encoding="utf-8")
    run(f"{PYTHON} example.py", tmp_path)


@pytest.mark.parametrize(("first", "second"), ["ab", "ba"])
def test_the_example_of_a_dataset_reads_tables_of_several_versions_in_any_order(tmp_path, first, second):
    """A version without a column writes a table before or after one with it."""
    (code,) = [text for *_, text in FENCE.findall(TEXTS["evaluation.md"]) if "runs.parquet" in text]
    folder = tmp_path / "dataset" / "metrics" / "date=2020-01-01"
    folder.mkdir(parents=True)
    rows = pl.DataFrame({"log_id": ["x", "x"], "config": ["c", "c"], "lane_left_error_m": [0.25, -0.75]})
    rows.write_parquet(folder / f"{first}.parquet")
    rows.drop("lane_left_error_m").with_columns(log_id=pl.lit("y")).write_parquet(folder / f"{second}.parquet")
    runs = pl.DataFrame({"log_id": ["x", "y"], "config": ["c", "c"], "path": ["p", "q"], "settings": ["", ""]})
    runs.write_parquet(tmp_path / "dataset" / "runs.parquet")
    (tmp_path / "example.py").write_text(code)
    assert re.search(r"x +┆ c +┆ 0\.5 ", run(f"{PYTHON} example.py", tmp_path))


def test_type_checkers_see_what_the_examples_import():
    """Of a package with types, ``from a import b`` in its ``__init__`` is private; ``import b as b`` is public."""
    sources = [text for page in TEXTS.values() for *_, text in FENCE.findall(page)]
    found = [re.findall(r"^from (roadperc_stream\.\w+) import (.+)$", text, re.MULTILINE) for text in sources]
    imports = [(package, name) for of_one in found for package, names in of_one for name in names.split(", ")]
    assert imports, "no example imports from a package"
    for package, name in imports:
        init = ROOT / package.replace(".", "/") / "__init__.py"
        assert f" import {name} as {name}\n" in init.read_text(encoding="utf-8"), (package, name)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The report of the whole sample."""
    folder = readers_folder(tmp_path_factory.mktemp("reader"), 9)
    return run("roadperc-report logs/runs/demo/sample.mcap", folder).splitlines()


@pytest.mark.parametrize("page", ["README.md", "evaluation.md"])
def test_the_pages_show_lines_of_the_report(report, page):
    printed = report
    shown = [line for line in re.search(r"```text\n(.*?)```", TEXTS[page], re.DOTALL)[1].splitlines() if line]
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
    texts = "\n".join(TEXTS.values())
    assert set(re.findall(r"\broadperc-[a-z]+", texts)) == scripts
    programs = [*sorted(scripts), *(f"{PYTHON} -m roadperc_stream.tools.{name}" for name in BENCHES)]
    helps = "".join(run(f"{program} --help", ROOT) for program in programs)
    options = set(re.findall(r"(?<![\w-])--[a-z][a-z_-]*[a-z]", texts))
    assert {option for option in options - OTHERS if option not in helps} == set()


def test_every_make_target_of_the_pages_exists():
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"(?:^    |`)make ([a-z-]+)", "\n".join(TEXTS.values()), re.MULTILINE)) <= targets


@pytest.mark.parametrize("page", ["README.md", "CHANGELOG.md", "CONTRIBUTING.md"])
def test_links_beside_the_site_have_a_target(page):
    """``make docs`` checks those of docs/."""
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", TEXTS[page]):
        assert (ROOT / target).exists(), target


def test_the_tests_of_the_reliability_page_exist():
    named = set(re.findall(r"`(tests/[^`]+)`", TEXTS["reliability.md"]))
    assert len(named) > 5
    assert [name for name in named if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", sorted(TEXTS))
def test_sentences_are_short(page):
    """Text in backticks is one word; code blocks, comments and headings do not count, and a cell is a paragraph."""
    skipped = re.compile(r"```.*?```|<!--.*?-->|^(?:#|    ).*?$|\]\([^)]*\)", re.DOTALL | re.MULTILINE)
    sentences = re.split(
        r"(?<=[.!?:;])\s|\n\s*\n|\n[-*] |\n\d+\. |\|", re.sub(r"`[^`]*`", "CODE", skipped.sub("\n", TEXTS[page]))
    )
    assert [text for text in sentences if len(text.split()) > LONGEST_SENTENCE] == []
