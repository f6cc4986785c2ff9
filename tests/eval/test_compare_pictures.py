"""``roadperc-compare --pictures``: the worst frames of base and new side by side, also without their result logs."""

import os
import re
import shutil
import subprocess
from contextlib import contextmanager
from pathlib import Path

import cv2
import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli.compare import main
from roadperc_stream.cli.replay import main as replay_main
from tests.test_docs import TEXTS, environment
from tests.test_sample import SAMPLE

WIDTH_PX = 2 * 640 + 6
WORST = 30


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two equal replays; the table of the second one has a large error of the left lane in two moments."""
    folder = tmp_path_factory.mktemp("runs")
    shutil.copy(SAMPLE, folder / "drive.mcap")
    options = ["--set", "stereo.method=off", "--only", "lanes", "--quiet"]
    for name in ("base", "new"):
        assert replay_main([str(folder / "drive.mcap"), str(folder / f"{name}.mcap"), *options]) == 0
    table, worse = folder / "new.metrics.parquet", pl.col("frame")
    values = pl.col("lane_left_error_m") + pl.when(worse >= WORST).then(1 + worse / 100).when(worse < 9).then(
        0.5 + worse / 100
    )
    rows, facts = pl.read_parquet(table), pl.read_parquet_metadata(table)
    rows = rows.with_columns(values.fill_null(pl.col("lane_left_error_m")).alias("lane_left_error_m"))
    rows.write_parquet(table, metadata={key: text for key, text in facts.items() if key != "ARROW:schema"})
    return folder


def compared(runs, folder, monkeypatch, names=("base", "new")):
    """Exit code, the lines of the Markdown, and the pictures by name, after a comparison in another folder."""
    monkeypatch.chdir(folder)
    sides = [str(runs / f"{name}.metrics.parquet") for name in names]
    code = main([*sides, "--markdown", "report/comment.md", "--pictures", "pictures of it"])
    return code, Path("report/comment.md").read_text().splitlines(), sorted((folder / "pictures of it").glob("*"))


def shown_in(lines):
    return [match[1] for line in lines if (match := re.match(r"!\[.*\]\((.*)\)$", line))]


def test_the_worst_moments_are_drawn_and_the_markdown_shows_them(runs, tmp_path, monkeypatch):
    code, lines, pictures = compared(runs, tmp_path, monkeypatch)
    assert code == 1
    assert [path.name for path in pictures] == ["1_base_frame_39.jpg", "2_base_frame_8.jpg"]
    assert shown_in(lines) == [f"../pictures%20of%20it/{path.name}" for path in pictures]
    assert any(
        re.match(r"frame 39 of base: lane left error .* → 1\.\d+ m; base left, new right", line) for line in lines
    )
    for path in pictures:
        assert cv2.imread(str(path)).shape == (480, WIDTH_PX, 3)


@contextmanager
def without(*paths):
    """The files have other names during the block."""
    for path in paths:
        path.rename(path.with_suffix(".hidden"))
    try:
        yield
    finally:
        for path in paths:
            path.with_suffix(".hidden").rename(path)


def test_a_frame_without_result_log_is_replayed(runs, tmp_path, monkeypatch):
    kept = [cv2.imread(str(path)) for path in compared(runs, tmp_path, monkeypatch)[2]]
    (tmp_path / "again").mkdir()
    with without(runs / "base.mcap", runs / "new.mcap"):
        _, lines, pictures = compared(runs, tmp_path / "again", monkeypatch)
    assert len(shown_in(lines)) == len(pictures) == 2
    for picture, expected in zip(pictures, kept, strict=True):
        assert (cv2.imread(str(picture)) == expected).all()


def test_a_missing_log_is_a_line(runs, tmp_path, monkeypatch):
    (tmp_path / "neither").mkdir()
    with without(runs / "drive.mcap", runs / "base.mcap"):
        code, lines, pictures = compared(runs, tmp_path, monkeypatch)
        with without(runs / "new.mcap"):
            neither = compared(runs, tmp_path / "neither", monkeypatch)
    assert (code, len(pictures)) == (1, 2)
    assert any(re.match(r"- picture 1, base: no picture: .*drive\.mcap: no such file", line) for line in lines)
    assert cv2.imread(str(pictures[0]))[:, :600].std() < 1
    assert (neither[0], neither[2]) == (1, [])
    assert sum("no picture: " in line for line in neither[1]) == 4


def test_without_a_worse_frame_there_is_no_folder(runs, tmp_path, monkeypatch):
    code, lines, _ = compared(runs, tmp_path, monkeypatch, ("base", "base"))
    assert code == 0
    assert "- no pictures: no frame is worse" in lines
    assert not (tmp_path / "pictures of it").exists()


FILES = dict(re.findall(r'^```\w+ title="(\S+)"\n(.*?)^```$', TEXTS["ci.md"], re.DOTALL | re.MULTILINE))


@pytest.mark.long
def test_the_scripts_of_the_page_compare_two_commits(tmp_path):
    """The comment's script gets a ``gh`` that only notes its arguments."""
    project, remote = tmp_path / "project", tmp_path / "remote.git"
    for name, text in FILES.items():
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).write_text(text)
    (project / "logs").mkdir()
    whole = log.summarise(SAMPLE)
    with log.LogWriter(project / "logs" / "drive.mcap") as writer:
        for message in log.read(whole, end_ns=whole.first_ns + 10**9):
            writer.write(message)
    (project / "gh").write_text('#!/bin/sh\necho "$*" >> gh.txt\n')
    (project / "gh").chmod(0o755)

    def run(command):
        named = {f"GIT_{who}_{what}": "a@b" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
        variables = environment() | named | {"GITHUB_REPOSITORY": "me/project"}
        variables["PATH"] = f"{project}{os.pathsep}{variables['PATH']}"
        return subprocess.run(
            command, shell=True, cwd=project, env=variables, capture_output=True, text=True, check=False
        )

    commit = "git add ci logs roadperc.toml && git commit -qm one"
    (project / "roadperc.toml").write_text("[odometry]\nenabled = false\n")
    assert (
        run(
            f"git init -q -b main . && git init -q --bare {remote} && git remote add origin {remote} && {commit}"
        ).returncode
        == 0
    )
    (project / "roadperc.toml").write_text("[odometry]\nenabled = false\n[surface]\ninlier_m = 1.5\n")
    assert run(commit).returncode == 0
    done = run("sh ci/compare.sh HEAD^1")
    assert done.returncode == 1, done.stderr
    assert "settings that differ: surface.inlier_m 0.05 → 1.5" in done.stdout
    cached = (project / "results" / "base" / "runs.parquet").stat().st_mtime_ns
    assert run("sh ci/compare.sh HEAD^1").returncode == 1
    assert (project / "results" / "base" / "runs.parquet").stat().st_mtime_ns == cached
    done = run("sh ci/comment.sh 7")
    assert done.returncode == 0, done.stderr
    pushed = run("git ls-tree -r --name-only $(git ls-remote origin pictures-7 | cut -f 1)").stdout.split()
    body = (project / "results" / "body.md").read_text()
    addresses = re.findall(r"\]\(https://github.com/me/project/blob/[0-9a-f]{40}/(\S+)\?raw=true\)", body)
    assert addresses
    assert addresses == pushed
    assert "issues/7/comments -F body=@results/body.md" in (project / "gh.txt").read_text()
    (project / "roadperc.toml").write_text("[odometry]\nnothing = 1\n")
    assert run(commit).returncode == 0
    assert run("sh ci/compare.sh HEAD^1").returncode == 3
