"""roadperc-check: known answers of every statistic, skipped criteria, files for other programs, and errors."""

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from junitparser import Error, Failure, JUnitXml, Skipped

from roadperc_stream.cli import check, replay, report
from roadperc_stream.eval.criteria import DEFAULT_CRITERIA, Effect, effects, read_criteria
from roadperc_stream.eval.results import write_json
from tests.commands import SCRIPTS
from tests.eval.dataset.datasets import small_dataset
from tests.eval.tables import outcome, row, usage_error, write
from tests.test_sample import SAMPLE

SCRIPT = Path(__file__).parents[2] / "docs" / "bisect.sh"
ERRORS_M = [0.1, -0.2, 0.3, None, 0.4]
STATUSES = ["measured", "lost", "lost", "measured", "lost"]


@pytest.fixture
def table(tmp_path):
    """Five frames, 50 ms each: four errors, and two losses of the lane."""
    rows = [
        row(k, lane_left_error_m=e, lane_left_status=s) for k, (e, s) in enumerate(zip(ERRORS_M, STATUSES, strict=True))
    ]
    return write(tmp_path / "out.metrics.parquet", rows)


def checked(capsys, tmp_path, text, *runs):
    """Exit code, stdout, stderr, and the criteria of the JSON file."""
    (tmp_path / "criteria.toml").write_text(text)
    found = tmp_path / "found.json"
    found.unlink(missing_ok=True)
    given = outcome(check.main, capsys, *runs, "--criteria", tmp_path / "criteria.toml", "--json", found)
    return *given, json.loads(found.read_text())["criteria"] if found.exists() else {}


@pytest.mark.parametrize(
    ("keys", "value", "result"),
    [
        ('metric = "lane_left_error_m", statistic = "mean", most = 0.3', 0.25, "passed"),
        ('metric = "lane_left_error_m", statistic = "median", most = 0.2', 0.25, "failed"),
        ('metric = "lane_left_error_m", statistic = "p95", most = 0.385', 0.385, "passed"),
        ('metric = "lane_left_error_m", statistic = "max", most = 0.3', 0.4, "failed"),
        ('metric = "lane_left_error_m", statistic = "max", most = 0.5, least_coverage = 0.9', 0.4, "failed"),
        ('metric = "lane_left_error_m", statistic = "share", within = 0.3, least = 0.75', 0.75, "passed"),
        ('metric = "lane_left_error_m", statistic = "max", most = 0.3, filter = "frame < 4"', 0.3, "passed"),
        ('metric = "lane_left_error_m.coverage", statistic = "mean", least = 0.9', 0.8, "failed"),
        ('metric = "lane_left_status.measured", statistic = "mean", least = 0.4', 0.4, "passed"),
        ('metric = "total_ms", statistic = "mean", most = 10', 10, "passed"),
        ('column = "lane_left_error_m", statistic = "min", least = -0.1', -0.2, "failed"),
        ("statistic = 'rate', event = \"lane_left_status = 'lost'\", most = 480", 480, "passed"),
        ('metric = "step_error_m", statistic = "mean", most = 1', None, "skipped"),
        ('metric = "lane_right_error_m", statistic = "mean", most = 1', None, "skipped"),
        ('metric = "lane_right_error_m", statistic = "mean", most = 1, least_coverage = 0.1', None, "failed"),
        ('metric = "lane_left_error_m", statistic = "mean", most = 0, least_frames = 6', None, "skipped"),
        ('metric = "lane_left_error_m", statistic = "mean", most = 0, filter = "frame > 9"', None, "skipped"),
    ],
)
def test_statistics_have_known_values(keys, value, result, capsys, table, tmp_path):
    code, *_, criteria = checked(capsys, tmp_path, f"criterion = [{{ name = 'one', {keys} }}]", table)
    assert criteria["one"]["outcome"] == result
    assert criteria["one"]["value"] == (value if value is None else pytest.approx(value))
    assert code == {"passed": 0, "failed": 1, "skipped": 3}[result]


FAILING = """
[[criterion]]
metric = "lane_left_error_m"
statistic = "max"
most = 0.2
per_log = true
[[criterion]]
metric = "step_error_m"
statistic = "mean"
most = 0.2
[[criterion]]
name = "height"
metric = "lane_left_error_m"
statistic = "p5"
least = 0.0
"""


def test_a_failure_names_the_frame_and_its_command(capsys, table, tmp_path):
    good = write(tmp_path / "good.metrics.parquet", [row(0, "b" * 16, lane_left_error_m=0.1)])
    code, out, err, criteria = checked(capsys, tmp_path, FAILING, table, good)
    command = f"roadperc-view {tmp_path / 'out.metrics.parquet'} --frame 4"
    assert (code, err) == (1, "failed: lane_left_error_m max\n")
    assert out.splitlines() == [
        f"check: failed, 6 frames of 2 runs, {tmp_path / 'criteria.toml'}",
        "failed   lane_left_error_m max in 1 of 2 logs, worst out: 0.4 m, at most 0.2 m; coverage 80.0 %",
        f"         worst frame: {command}",
        "passed   height",
        "skipped  step_error_m mean: no truth",
        "1 passed, 1 failed, 1 skipped",
    ]
    logs = criteria["lane_left_error_m max"]["logs"]
    assert {name: found["outcome"] for name, found in logs.items()} == {"out": "failed", "good": "passed"}
    assert logs["out"]["worst"] == {"log": "out", "frame": 4, "value": 0.4, "command": command}


def test_files_for_other_programs(capsys, table, tmp_path):
    (tmp_path / "criteria.toml").write_text(FAILING)
    given = [table, "--criteria", tmp_path / "criteria.toml", "--junit", tmp_path / "a.xml", "--markdown"]
    assert outcome(check.main, capsys, *given, tmp_path / "a.md")[0] == 1
    (suite,) = JUnitXml.fromfile(str(tmp_path / "a.xml"))
    assert (suite.tests, suite.failures, suite.skipped) == (3, 1, 1)
    found = {case.name: (case.classname, [type(result) for result in case.result]) for case in suite}
    assert found == {
        "lane_left_error_m max, out": ("out", [Failure]),
        "step_error_m mean": ("out", [Skipped]),
        "height": ("out", []),
    }
    result = next(iter(suite)).result[0]
    assert "0.4 m, at most 0.2 m" in result.text
    assert "0.4 m, at most 0.2 m" in result.message
    markdown = (tmp_path / "a.md").read_text()
    assert markdown.startswith("## Check: failed\n")
    assert "| lane\\_left\\_error\\_m max | failed | out | 0.4 m, at most 0.2 m; coverage 80.0 % | 5 |" in markdown


def test_a_second_summary_is_appended_and_the_text_of_others_stays(capsys, table, tmp_path):
    (tmp_path / "criteria.toml").write_text(FAILING)
    (tmp_path / "a.md").write_text("# Nightly\n")
    outcome(check.main, capsys, table, "--criteria", tmp_path / "criteria.toml", "--markdown", tmp_path / "a.md")
    outcome(report.main, capsys, table, "--markdown", tmp_path / "a.md")
    markdown = (tmp_path / "a.md").read_text()
    assert re.findall("^#+ .*", markdown, re.MULTILINE)[:2] == ["# Nightly", "## Check: failed"]
    assert markdown.count("\n\n## ") == 2


def test_missing_files_and_contradicting_options(capsys, table, tmp_path):
    assert outcome(check.main, capsys, tmp_path / "no.mcap")[0] == 3
    assert outcome(check.main, capsys, table, "--criteria", tmp_path / "no.toml")[0] == 3
    assert "--force belongs to --init" in usage_error(check.main, capsys, table, "--force")
    assert "remove --json" in usage_error(check.main, capsys, table, "--init", "a.toml", "--json", "a.json")


@pytest.mark.parametrize("files", [("RUN",), ("limits.toml",), ("out.mcap",), ("a.txt", "a.txt")])
def test_results_replace_no_input_and_no_other_result(files, capsys, table, tmp_path):
    before, paths = table.read_bytes(), [str(table if name == "RUN" else tmp_path / name) for name in files]
    options = [word for pair in zip(("--json", "--junit"), paths, strict=False) for word in pair]
    code, _, error = outcome(check.main, capsys, table, *options)
    assert (code, error.startswith(f"error: {paths[0]}: "), table.read_bytes()) == (3, True, before)
    assert list(tmp_path.iterdir()) == [table]


def test_names_in_json_are_unique_and_valid_for_mlflow(tmp_path):
    write_json(tmp_path / "a.json", {"a+b": math.nan, "a=b": [1, math.inf], "c": {"d:": 2.0}})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a_b": None, "a_b 1": [1, None], "c": {"d_": 2.0}}


def test_effects_of_metrics(tmp_path):
    path = tmp_path / "criteria.toml"
    path.write_text("[metrics.lane_left_error_m]\nrelevant = 0.02\nlimit = 1\n")
    assert effects(path) == {"lane_left_error_m": Effect(relevant=0.02, limit=1.0)}


def test_a_failed_log_of_a_batch_is_an_error(capsys, tmp_path):
    dataset, junit = small_dataset(tmp_path / "dataset"), tmp_path / "a.xml"
    (tmp_path / "c.toml").write_text('criterion = [{ metric = "lane_left_error_m", statistic = "mean", most = 9 }]')
    code, out, err = outcome(check.main, capsys, dataset, "--criteria", tmp_path / "c.toml", "--junit", junit)
    assert (code, out.splitlines()[0]) == (3, f"check: error, 20 frames of 4 runs, {tmp_path / 'c.toml'}")
    assert err == "error: /drives/bad.mcap: has no result: /drives/bad.mcap: cut off at byte 7\n"
    (suite,) = JUnitXml.fromfile(str(junit))
    assert [type(case.result[0]) for case in suite if case.result] == [Error] * 3


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[[criterion]", "not TOML"),
        ("", "has no [[criterion]]"),
        ("[[criterion]]\nmetrik = 1", "criterion 1: no key metrik; did you mean metric?"),
        ('criterion = [{ metric = "a" }]', "criterion 1 ('a'): expected the key statistic"),
        ('criterion = [{ metric = "lane_left_eror_m", statistic = "max", most = 1 }]', "mean lane_left_error_m?"),
        ('criterion = [{ column = "frame", statistic = "max", most = "1" }]', "most: expected a valid number"),
        ('criterion = [{ column = "frame", statistic = "max" }]', "expected one of most and least"),
        ('criterion = [{ column = "frame", statistic = "share", most = 1 }]', "within belongs to the statistic share"),
        ('criterion = [{ column = "fram", statistic = "max", most = 1 }]', "column: no column fram; similar"),
        ('criterion = [{ column = "reasons", statistic = "max", most = 1 }]', "expected numbers"),
        ('criterion = [{ column = "frame", statistic = "max", most = 1, filter = "a +" }]', "filter: 'a +' is no SQL"),
        ('criterion = [{ column = "frame", statistic = "max", most = 1, filter = "fram > 1" }]', "columns: frame"),
        (f'criterion = [{{ column = "frame", statistic = "max", most = 1, filter = "{1200 * "("}" }}]', "1000 at most"),
        ('criterion = [{ column = "frame", statistic = "max", most = 1, name = "a,b" }]', "expected a name of letters"),
        (2 * '[[criterion]]\ncolumn = "frame"\nstatistic = "max"\nmost = 1\n', "2 criteria are named 'frame max'"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_an_error_that_names_file_and_key(text, expected, capsys, table, tmp_path):
    code, out, err, _ = checked(capsys, tmp_path, text, table)
    assert (code, out, err.count("\n")) == (3, "", 1)
    assert err.startswith(f"error: {tmp_path / 'criteria.toml'}: ")
    assert expected in err


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    """A replay of ten frames."""
    folder = tmp_path_factory.mktemp("check")
    assert replay.main([str(SAMPLE), str(folder / "out.mcap"), "--frames", "10", "--quiet"]) == 0
    return folder / "out.mcap"


def test_the_default_criteria_pass_on_the_sample(sample, capsys):
    code, out, _ = outcome(check.main, capsys, sample)
    assert code == 0, out
    skipped = [line for line in out.splitlines() if line.startswith("skipped")]
    assert skipped == [line for line in skipped if "hindsight" in line], "ten frames have truth, but no later frames"
    assert f"{len(read_criteria(DEFAULT_CRITERIA)) - out.count('hindsight')} passed, 0 failed" in out


def test_written_criteria_pass_on_their_runs_and_fail_on_worse_ones(sample, capsys, tmp_path):
    path = tmp_path / "criteria.toml"
    assert outcome(check.main, capsys, sample, "--init", path)[0] == 0
    assert "\n  # lane_left_error_m: mean 0.0" in path.read_text()
    assert len(read_criteria(path)) > 60
    code, out, _ = outcome(check.main, capsys, sample, "--criteria", path)
    assert (code, len(out.splitlines())) == (0, 3)
    assert outcome(check.main, capsys, sample, "--init", path)[0] == 3
    assert outcome(check.main, capsys, sample, "--init", path, "--force")[0] == 0
    limit = 'metric = "lane_left_error_m", statistic = "max", most = 0.'
    path.write_text(path.read_text().replace(limit, f"{limit}000"))
    assert outcome(check.main, capsys, sample, "--criteria", path)[0] == 1


def test_git_bisect_finds_the_commit_with_the_bad_setting(tmp_path):
    """The third commit of four fits the road badly; a commit that cannot be replayed is skipped."""
    repository, tools = tmp_path / "repository", tmp_path / "tools"
    repository.mkdir()
    tools.mkdir()
    for name in ("roadperc-replay", "roadperc-check"):
        module, _, function = SCRIPTS[name].partition(":")
        code = f"import sys; from {module} import {function}; sys.exit({function}())"
        (tools / name).write_text(f"#!{sys.executable}\n{code}\n")
        (tools / name).chmod(0o755)
    limits = tmp_path / "limits.toml"
    limits.write_text('criterion = [{ metric = "surface_angle_error_deg", statistic = "max", most = 0.4 }]')
    given = [SCRIPT, SAMPLE, limits, "--config", "roadperc.toml", "--frames", "1", "--only", "surface"]
    variables = os.environ | {"PATH": f"{tools}{os.pathsep}{os.environ['PATH']}", "GIT_CONFIG_GLOBAL": os.devnull}
    variables["TMPDIR"] = str(tmp_path)

    def run(*command, code=0):
        words = [str(word) for word in command]
        ended = subprocess.run(words, cwd=repository, env=variables, capture_output=True, text=True, check=False)
        assert ended.returncode == code, ended.stdout + ended.stderr
        return ended.stdout

    def git(*words):
        return run("git", "-c", "user.name=a", "-c", "user.email=a@example.org", *words)

    git("init", "--quiet")
    for number, inlier_m in enumerate((0.05, 0.04, 1.0, 0.9)):
        (repository / "roadperc.toml").write_text(f"[surface]\ninlier_m = {inlier_m}\n")
        git("add", ".")
        git("commit", "--quiet", "-m", f"commit {number}")
    bad = git("rev-parse", "HEAD~1").strip()
    git("bisect", "start", "HEAD", "HEAD~3")
    said = git("bisect", "run", *given)
    assert f"{bad} is the first bad commit" in said
    shown = re.findall(r"roadperc-view (\S+) --frame 0", said)
    assert shown
    assert all(Path(path).is_file() for path in shown)
    assert len(list(tmp_path.glob("bisect.*"))) == len(shown)
    (repository / "roadperc.toml").write_text("[surface")
    run(*given, code=125)
