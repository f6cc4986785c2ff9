"""The HTML page: one file that needs no network, for any table."""

import json
import re
import shlex
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.cli.report import main
from roadperc_stream.config import load_config
from roadperc_stream.eval.html.page import RUNS_DRAWN
from roadperc_stream.output.tables import table_facts
from roadperc_stream.system.time import NS_PER_S
from tests.eval.dataset.datasets import small_dataset
from tests.eval.tables import START_NS, STEP_NS, row, write
from tests.eval.test_html_parts import STAMP, write_log

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
CHROMIUM = shutil.which("chromium")
QUIET = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--virtual-time-budget=8000"),
)
SELECTS = """<script>setInterval(() => document.documentElement.dataset.drawn && select(0.03), 100)</script>"""
"""Points at a time as the mouse does."""
FULL = {
    "surface_source": "depth",
    "lane_left_status": "measured",
    "lane_left_offset_m": 1.75,
    "lane_left_raw_offset_m": 1.7,
    "nearest_object_m": 5.0,
    "stereo_epe_px": 0.5,
    "odom_x_m": 1.0,
}


class Page(HTMLParser):
    """Elements, the resources they name, visible text and the charts' data."""

    def __init__(self, text):
        super().__init__()
        self.links, self.images, self.text, self.inside, self.specs = [], [], "", [], {}
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.inside += [found.get("id", tag)] if tag in {"script", "style"} else []
        self.links += [found[name] for name in ("src", "href", "action", "srcset", "poster", "data") if name in found]
        self.images += [found["src"]] if tag == "img" else []

    def handle_endtag(self, tag):
        if tag in {"script", "style"}:
            self.inside.pop()
        self.text += " " if tag in {"td", "th", "small", "li"} else ""

    def handle_data(self, data):
        if self.inside == ["specs"]:
            self.specs = json.loads(data)
        elif not self.inside:
            self.text += data


def report(tmp_path, *runs, name="report.html"):
    target = tmp_path / name
    assert main([*(str(run) for run in runs), "--html", str(target)]) == 0
    text = target.read_text(encoding="utf-8")
    return Page(text), text


def with_log(path, log, stamps, **columns):
    """A metrics table of frames at given stamps whose footer names the log with results."""
    write(path, [row(k, **columns) for k in range(len(stamps))])
    table = pl.read_parquet(path).with_columns(stamp_ns=pl.Series(stamps, dtype=pl.Int64)).to_arrow()
    facts = {"roadperc.log": str(log), "roadperc.source": "/somewhere/in.mcap"}
    pl.from_arrow(table).write_parquet(path, metadata=facts)
    return path


def test_nothing_on_the_page_is_fetched(tmp_path):
    page, text = report(tmp_path, write(tmp_path / "a.metrics.parquet", [row(k, **FULL) for k in range(5)]))
    assert page.links
    assert all(link.startswith(("data:", "#")) for link in page.links), page.links
    style = text[text.index("<style>") : text.index("</style>")]
    assert not re.search(r"url\(|@import", style)
    assert not re.search(r"https?://", page.text)
    assert "Content-Security-Policy\" content=\"default-src 'none';" in text


def test_names_are_escaped_everywhere(tmp_path):
    hostile = "<script>alert(1)<b>&x"
    paths = [tmp_path / f"{name}.metrics.parquet" for name in (hostile, "plain")]
    for path in paths:
        write(path, [row(k, log_id="<img src=x onerror=alert(2)>", **FULL) for k in range(3)])
    page, text = report(tmp_path, *paths)
    assert hostile in page.text
    assert "<script>alert" not in text
    assert "<img src=x" not in text
    names = {trace["name"] for spec in page.specs.values() for trace in spec["data"]}
    assert "&lt;script&gt;alert(1)&lt;b&gt;&amp;x" in names


@pytest.mark.parametrize(("frames", "columns"), [(1, {}), (2, {"lane_left_offset_m": 1.0}), (1, FULL), (5, FULL)])
def test_any_table_gives_a_page(tmp_path, frames, columns):
    page, _ = report(tmp_path, write(tmp_path / "a.metrics.parquet", [row(k, **columns) for k in range(frames)]))
    assert "What was replayed" in page.text
    assert ("No verdict, because no frame has truth" in page.text) == ("stereo_epe_px" not in columns)


def test_two_runs_start_with_the_verdict_and_the_worst_frame_and_its_command(tmp_path):
    paths = [tmp_path / name / "a.metrics.parquet" for name in ("base", "slow")]
    for error, settings, path in zip((0.1, 2.0), ((), ("lanes.hold_s=2",)), paths, strict=True):
        path.parent.mkdir()
        write(path, [row(k, stereo_epe_px=error + k / 1000) for k in range(40)])
        facts = table_facts(path, path, load_config(settings=settings))
        pl.read_parquet(path).write_parquet(path, metadata=facts)
    page, _ = report(tmp_path, *paths)
    words = " ".join(page.text.split())
    assert "Settings that differ base/a slow/a lanes.hold_s 0.5 2.0 What was replayed" in words
    verdict = words[: words.index("Over time")]
    assert "New is worse: 1 of" in verdict
    assert re.search(r"0\.1\d+ px → 2\.\d+ px, \+1\.90 px", verdict)
    logs = shlex.join(map(str, paths))
    assert re.search(rf"Worst frame \d+: stereo disparity.* {re.escape(logs)} --frame \d+", verdict)
    worst = words[words.index("Worst frames") :]
    assert re.findall(r"(\d+)\. frame (\d+) at", worst)[:2] == [("1", "39"), ("2", "19")]


def test_a_dataset_gives_a_page_and_pages_of_its_bad_logs(tmp_path, capsys):
    small_dataset(tmp_path / "batch")
    assert main([str(tmp_path / "batch"), "--html", str(tmp_path / "page.html")]) == 0
    page = Page((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert capsys.readouterr().out.endswith(
        f"pass --full for all tables, --by EXPRESSION for slices\n\npage   {tmp_path / 'page.html'}\n"
    )
    assert "3 of 7 runs failed" in page.text
    linked = [tmp_path / link for link in page.links if link.startswith("page_logs/")]
    assert {path.stem for path in linked} == {f"failed_{k}" for k in (1, 2, 3)} | {"worst_1", "worst_2"}
    assert all(path.is_file() for path in linked)
    words = " ".join(Page(linked[-1].read_text(encoding="utf-8")).text.split())
    assert f"roadperc-view {shlex.quote(str(tmp_path / 'batch'))} --log" in words


def test_a_note_counts_the_runs_beyond_the_colours(tmp_path):
    for k in range(RUNS_DRAWN + 2):
        write(tmp_path / f"run{k}.metrics.parquet", [row(0, **FULL)])
    page, _ = report(tmp_path, tmp_path)
    assert f"The page shows the first {RUNS_DRAWN} runs; 2 more are left out." in page.text


def test_an_hour_at_20_hz_stays_below_ten_megabytes(tmp_path):
    frames, rng = 72_000, np.random.default_rng(1)
    first = pl.read_parquet(write(tmp_path / "one.metrics.parquet", [row(0)]))
    floats = [name for name, kind in first.schema.items() if kind == pl.Float64]
    columns = {name: rng.normal(1, 0.1, frames) for name in floats}
    table = first[[0] * frames].with_columns(
        pl.Series("frame", range(frames)),
        pl.Series("stamp_ns", START_NS + STEP_NS * np.arange(frames)),
        *(pl.Series(name, values) for name, values in columns.items()),
    )
    table.write_parquet(tmp_path / "hour.metrics.parquet")
    page, text = report(tmp_path, tmp_path / "hour.metrics.parquet")
    assert len(text.encode()) < 7e6
    assert max(len(trace["x"]) for spec in page.specs.values() for trace in spec["data"]) <= 1802
    shown = next(spec["data"][0]["y"] for spec in page.specs.values() if len(spec["data"][0]["y"]) > 100)
    assert max(shown) > 1.3


@pytest.mark.parametrize("moved", ["", "/gone/out.mcap"])
def test_each_worst_frame_has_one_picture(tmp_path, moved):
    log = write_log(tmp_path / "out.mcap", apart_ns=NS_PER_S)
    stamps = [STAMP, STAMP + NS_PER_S]
    table = with_log(tmp_path / "out.metrics.parquet", moved or log, stamps, stereo_epe_px=0.5, turn_error_deg=1.0)
    page, _ = report(tmp_path, table)
    assert len(page.images) == 3  # the worst frame is also at the top
    assert all(image.startswith("data:image/jpeg;base64,/9j/") for image in page.images)
    captions = " ".join(page.text.split())
    assert "1. frame 0 at 0.000 s stereo disparity error" in captions  # as the report names it
    assert "2. frame 1 at" in captions
    assert "somewhere" not in captions
    assert "in.mcap" in captions


def test_a_page_without_truth_shows_the_middle_of_the_log_at_once(tmp_path):
    log = write_log(tmp_path / "out.mcap")
    page, _ = report(tmp_path, with_log(tmp_path / "out.metrics.parquet", log, [STAMP - STEP_NS, STAMP]))
    words = " ".join(page.text.split())
    assert "No verdict" in words
    assert "frame 1, in the middle of the log" in words
    assert "Worst" not in words
    assert len(page.images) >= 1


def test_a_picture_lacks_unreadable_results_and_a_note_says_so(tmp_path):
    log = write_log(tmp_path / "out.mcap", objects=b"\xff\xfe")
    page, _ = report(tmp_path, with_log(tmp_path / "out.metrics.parquet", log, [STAMP], stereo_epe_px=0.5))
    assert len(page.images) == 2
    assert f"not drawn, because unreadable: /perception/objects: message at {STAMP} ns: 2 bytes are not a" in page.text


def test_a_log_that_was_replayed_again_gives_no_pictures(tmp_path):
    """They would show the second replay beside the numbers of the first."""
    out, table = tmp_path / "out.mcap", tmp_path / "out.metrics.parquet"
    replayed = [str(SAMPLE), str(out), "--frames", "2", "--quiet", "--force"]
    assert replay_main(replayed) == 0
    assert report(tmp_path, table)[0].images
    shutil.copy(table, tmp_path / "first.metrics.parquet")
    assert replay_main([*replayed, "--set", "surface.inlier_m=0.5"]) == 0
    page, _ = report(tmp_path, tmp_path / "first.metrics.parquet")
    assert not page.images
    assert "out.mcap was replayed again with another configuration" in page.text


@pytest.mark.parametrize("with_truth", [True, False])
def test_the_position_error_is_drawn_if_there_is_truth(tmp_path, with_truth):
    def pose(prefix, x_m):
        return {f"{prefix}_{name}": 0.0 for name in ("y_m", "z_m", "qx", "qy", "qz")} | {
            f"{prefix}_x_m": x_m, f"{prefix}_qw": 1.0
        }  # fmt: skip

    drive = [pose("odom", 0.5 * k) | (pose("true", 0.6 * k) if with_truth else {}) for k in range(3)]
    rows = [row(k, **poses) for k, poses in enumerate(drive)]
    page, _ = report(tmp_path, write(tmp_path / "a.metrics.parquet", rows))
    assert "Trajectory" in page.text
    assert ("Position error over distance" in page.text) == with_truth


def test_poses_without_orientation_are_not_drawn(tmp_path):
    still = {f"odom_{axis}_m": 0.0 for axis in "xyz"} | {f"odom_q{axis}": 0.0 for axis in "xyzw"}
    page, _ = report(tmp_path, write(tmp_path / "a.metrics.parquet", [row(k, **still) for k in range(3)]))
    assert "Trajectory" not in page.text


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("no image", "a.mcap holds no camera image of 1 of these frames"),
        ("no log", "no more pictures: a.mcap"),
        ("gone", "a.mcap is not where the table says"),
    ],
)
def test_a_note_says_why_a_log_has_no_pictures(tmp_path, content, said):
    log = tmp_path / "a.mcap"
    if content == "no image":
        write_log(log, image=False)
    elif content == "no log":
        log.write_bytes(b"not an mcap")
    page, _ = report(tmp_path, with_log(tmp_path / "a.metrics.parquet", log, [STAMP], stereo_epe_px=0.5))
    assert not page.images
    assert said in page.text
    assert "stereo disparity" in page.text


def test_only_a_page_is_replaced(tmp_path, capsys):
    table = write(tmp_path / "a.metrics.parquet", [row(0)])
    before = table.read_bytes()
    assert main([str(table), "--html", str(table)]) == 1
    assert table.read_bytes() == before
    assert "expected a name that ends in .html or .htm" in capsys.readouterr().err
    (tmp_path / "folder.html").mkdir()
    assert main([str(table), "--html", str(tmp_path / "folder.html")]) == 1
    assert capsys.readouterr().err.startswith(f"error: {tmp_path / 'folder.html'}: ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.metrics.parquet", "folder.html"]


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not opened in a browser")
def test_a_browser_draws_every_chart_and_asks_for_nothing(tmp_path):
    log = write_log(tmp_path / "out.mcap")
    page, text = report(tmp_path, with_log(tmp_path / "out.metrics.parquet", log, [STAMP, STAMP + STEP_NS], **FULL))
    (tmp_path / "report.html").write_text(text + SELECTS, encoding="utf-8")
    command = [CHROMIUM, *QUIET, f"--user-data-dir={tmp_path / 'profile'}", "--enable-logging=stderr", "--dump-dom"]
    done = subprocess.run(
        [*command, (tmp_path / "report.html").as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    assert f'data-drawn="{len(page.specs)}"' in done.stdout
    assert done.stdout.count('class="main-svg"') >= len(page.specs) > 3
    assert done.stdout.count('class="cursor"') == text.count("plot timed") > 2
    assert 'data-time="0.03"' in done.stdout
    assert re.search(
        r"<figcaption>out, frame 1, 0.05 s<code>roadperc-view [^<]+out.mcap\S* --frame 1</code>", done.stdout
    )
    assert "violates the following Content Security Policy" not in done.stderr
    assert "CONSOLE" not in done.stderr
