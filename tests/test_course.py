"""docs/course.md is true: its links, its stages and its settings, and the published values on the course's own data."""

import json
import re
import shutil
import sys

import numpy as np
import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli import convert
from roadperc_stream.cli.replay import main as replay_main
from tests import course
from tests.test_docs import OPENS_VIEWER, PYTHON, ROOT, TEXTS, run, shorten

PAGE = TEXTS["course.md"]
TITLED = dict(re.findall(r'^```\w+ title="(\S+)"\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE))
OWN = {code: stage for stage, code in re.findall(r"--set (\w+)\.implementation=(\S+)", PAGE)}
ERRORS = {
    "my_points:surface": ("surface_height_error_m", 0.3),
    "my_ransac:surface": ("surface_height_error_m", 0.3),
    "my_lines:lanes": ("lane_left_error_m", 0.1),
    "my_filter:objects": ("object_distance_error_m", 8.0),
    "my_stereo:stereo": ("stereo_epe_px", 0.8),
    "my_motion:Motion": ("step_error_m", 0.1),
}
"""Column of an own stage's error, and a bound of its median; half of that is usual."""


@pytest.mark.parametrize("page", ["course.md", "chain.md"])
def test_links_to_the_code_lead_to_what_they_name(page):
    links = re.findall(r"\[`([\w./]+)`\]\(\.\./([\w/]+\.py)\)", TEXTS[page])
    assert len(links) > 10
    for name, path in links:
        source = ROOT / path
        defined = rf"^(def|class) {name}\b"
        assert path.endswith(f"/{name}") or re.search(defined, source.read_text(), re.MULTILINE), (name, path)


def test_the_table_names_functions_of_the_simple_version():
    simple = (ROOT / "tools" / "bench" / "course.py").read_text()
    cells = re.findall(r"\| `my_\w+\.py` \| (.+) \|$", PAGE, re.MULTILINE)
    assert len(cells) == 6
    for name in re.findall(r"`(\w+)`", " ".join(cells)):
        assert re.search(rf"^(def|class) {name}\b", simple, re.MULTILINE), name


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files of the page and the first frames of the sample; the stages can be imported."""
    folder = tmp_path_factory.mktemp("course")
    for name, text in TITLED.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    shutil.copy(ROOT / "logs" / "sample.mcap", folder)
    shorten(folder / "sample.mcap", 0.25)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [*sys.path, str(folder)])
        yield folder


def replayed(source, *options):
    """Metrics and objects of a log."""
    target = source.with_suffix(".out.mcap")
    assert replay_main([str(source), str(target), "--force", "--quiet", *map(str, options)]) == 0
    return [pl.read_parquet(target.with_suffix(f".{table}.parquet")) for table in ("metrics", "objects")]


@pytest.mark.parametrize("code", OWN)
def test_every_stage_of_the_page_runs_and_has_a_small_error(folder, code):
    metrics, _ = replayed(folder / "sample.mcap", "--set", f"{OWN[code]}.implementation={code}", "--debug")
    column, most = ERRORS[code]
    errors = metrics[column].drop_nulls().abs()
    assert len(errors) >= 4
    assert errors.median() < most


def test_the_ransac_of_the_page_has_a_picture_and_the_plain_fit_has_none(folder):
    for code, pictures in (("my_ransac:surface", 5), ("my_points:surface", 0)):
        replayed(folder / "sample.mcap", "--set", f"surface.implementation={code}", "--debug", "--only", "surface")
        found = log.read(log.summarise(folder / "sample.out.mcap"))
        assert sum(m.channel.topic == "/perception/debug/surface" for m in found) == pictures


@pytest.fixture(scope="module")
def assignment(folder, data_dir):
    """Metrics and objects of the last assignment's frames with the course's rules; depth is that of the planes."""
    data = folder / "data"
    for part in ("rgb", "segmentation"):
        shutil.copytree(data_dir / "course_frames" / part, data / part, copy_function=shutil.copyfile)
    for name in ("calibration.json", "detections.json"):
        shutil.copy(folder / name, data)
    (data / "depth").mkdir()
    rows, columns = np.mgrid[1:961, 1:1281]
    for number, of_frame in expected(data_dir).items():
        a, b, c, d = of_frame["plane_abcd"]
        with np.errstate(divide="ignore"):
            depth_m = -d / (a * (columns - 640) / 640 + b * (rows - 480) / 640 + c)
        depth_m[(depth_m < 0) | (depth_m > 1000)] = 1000
        np.savetxt(data / "depth" / f"{number}.dat", depth_m / 1000, delimiter=",", fmt="%.6f")
    assert convert.main([str(data), str(folder / "frames.mcap"), "--rate", "0.5", "--quiet"]) == 0
    return replayed(folder / "frames.mcap", "--config", folder / "course.toml")


def expected(data_dir):
    published = json.loads((data_dir / "course_frames" / "expected.json").read_text())
    return {number: published[number] for number in "01"}


def test_the_published_point(folder, data_dir, capsys):
    exec(compile(TITLED["point.py"], "point.py", "exec"), {})
    found = [float(n) for n in re.findall(r"[\d.]+", capsys.readouterr().out)]
    assert found == pytest.approx(expected(data_dir)["0"]["xyz_m_at_800_800"], abs=1e-9)


def test_the_published_planes(assignment, data_dir):
    metrics, _ = assignment
    assert metrics["camera_height_m"].round(4).to_list() == [1.4028, 1.3597]
    a, b, c, d = expected(data_dir)["0"]["plane_abcd"]
    assert metrics["camera_height_m"][0] == pytest.approx(d / np.linalg.norm((a, b, c)), abs=1e-4)
    assert metrics["camera_pitch_deg"][0] == pytest.approx(-np.degrees(np.arctan2(c, -b)), abs=0.005)
    assert round(metrics["camera_pitch_deg"][0], 2) == -0.41
    assert "height 1.4028 m and the pitch -0.41 degrees" in PAGE


def test_the_published_lines_and_detections(assignment, data_dir):
    metrics, objects = assignment
    assert (metrics["lane_proposals"][0], metrics["lane_merged"][0]) == (9, 5)
    for number, of_frame in expected(data_dir).items():
        rows = objects.filter(pl.col("frame") == int(number))
        assert rows["class_ratio"].to_list() == pytest.approx(of_frame["segmentation_ratio"], abs=0.0001)
        assert [k for k, kept in enumerate(rows["kept"]) if kept] == of_frame["kept"]
    distances = objects.filter("kept")["distance_m"].round(2).to_list()
    assert distances == [8.64, 6.89, 9.66]
    assert "8.64 m; 6.89 and 9.66 m" in " ".join(PAGE.split())


@pytest.mark.parametrize(("swapped", "nearest_m"), [(True, 28.9266), (False, 28.2873)])
def test_the_published_obstacle(folder, data_dir, swapped, nearest_m):
    """The page's calibration and settings; its first command swaps red and blue."""
    pair = folder / "pair"
    for name in ("left.png", "right.png"):
        shutil.copyfile(data_dir / "course_stereo" / name, pair / name)
    if swapped:
        (command,) = re.findall(r'^python -c "(.*)"$', PAGE, re.MULTILINE)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            exec(command, {})
    assert convert.main([str(pair), str(folder / "pair.mcap"), "--quiet", "--force"]) == 0
    _, objects = replayed(folder / "pair.mcap", "--config", folder / "course.toml", "--template", course.TEMPLATE)
    found = objects.row(0, named=True)
    assert (found["label"], found["x_min_px"], found["y_min_px"]) == ("template", 547, 479)
    assert found["distance_m"] == pytest.approx(nearest_m, abs=1e-4)
    assert f"--template {course.TEMPLATE}" in PAGE


@pytest.mark.long
def test_a_student_gets_through_the_page(tmp_path):
    """All commands in their order, with the files of the page saved when they come."""
    (tmp_path / "logs").mkdir()
    shutil.copy(ROOT / "logs" / "sample.mcap", tmp_path / "logs")
    shorten(tmp_path / "logs" / "sample.mcap", 0.3)
    for language, title, text in re.findall(
        r'^```(\w+)(?: title="(\S+)")?\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE
    ):
        if title:
            (tmp_path / title).parent.mkdir(exist_ok=True)
            (tmp_path / title).write_text(text, encoding="utf-8")
        if title in ("point.py", "boxes.py"):
            assert run(f"{PYTHON} {title}", tmp_path)
        for line in text.splitlines() if language == "sh" else ():
            run(f"{line} --save viewed.rrd" if OPENS_VIEWER.match(line) else line, tmp_path)
