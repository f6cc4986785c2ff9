"""What the bench says of a log in parts, on tables with known differences."""

import numpy as np
import polars as pl
import pytest

from roadperc_stream.tools.bench import split
from roadperc_stream.tools.bench.split_replays import SplitRun, runs_of

FRAMES = 300
RUN = SplitRun("mono", 1, 10.0, 5.0)


def metrics(step_m):
    k = np.arange(FRAMES)
    pose = dict.fromkeys(("qx", "qy", "qz"), np.zeros(FRAMES)) | {"qw": np.ones(FRAMES)}
    pose |= {"x_m": k * 1.0, "y_m": np.zeros(FRAMES), "z_m": np.zeros(FRAMES)}
    poses = {f"{side}_{name}": values for side in ("odom", "true") for name, values in pose.items()}
    columns = {name: np.zeros(FRAMES) for group in split._GROUPS.values() for name in group}
    return pl.DataFrame({"stamp_ns": k * 100_000_000, **columns, **poses}).with_columns(pl.Series("step_m", step_m))


def objects(names):
    box = {name: [0.0] * len(names) for name in ("x_min_px", "y_min_px", "x_max_px", "y_max_px")}
    return pl.DataFrame({"frame": range(len(names)), "track_id": names, "label": ["Car"] * len(names), **box})


def write(folder, item, table, names):
    table.write_parquet(item.table(folder, "metrics"))
    objects(names).write_parquet(item.table(folder, "objects"))


@pytest.fixture
def folder(tmp_path):
    step_m = np.ones(FRAMES)
    write(tmp_path, RUN.one_pass, metrics(step_m), ["1", "1", "1", "2"])
    step_m[[95, 120]] += 0.5, 0.25  # 0.5 and 3 s behind the seam, which is a second before the cut
    step_m[50] += 1.0  # in the first part
    step_m[200] += 0.0005  # less than counts
    joined = metrics(step_m).with_columns(odom_x_m=pl.col("odom_x_m") * 1.01)
    write(tmp_path, RUN, joined, ["1", "1", "5", "2"])
    return tmp_path


def test_what_differs_behind_the_first_cut(folder):
    found = split.differing(folder, [RUN], ("step_m",))
    assert found.share == pytest.approx(2 / 210)
    assert (found.median, found.largest, found.latest_s) == pytest.approx((0.375, 0.5, 3.0))
    assert str(split.differing(folder, [RUN], ("turn_deg",))) == "-"


def test_a_value_that_only_one_has_differs():
    ours, theirs = pl.Series([1.0, None, None, 4.0]), pl.Series([1.0, 2.0, None, None])
    assert split.difference(ours, theirs).tolist() == [0.0, np.inf, 0.0, np.inf]


def test_the_tables(folder):
    table = split.difference_table(folder, [RUN])
    cells = {item.label: item.cells[0][0] for item in table.rows}
    assert table.headers == ("5 s",)
    assert cells["mono: step, m"] == "1.0%: 0.38, 0.5; 3.0 s"
    assert cells["mono: tracks that begin anew"] == "1 of 2"
    assert "mono: turn, deg" not in cells
    (path,) = split.path_table(folder, [RUN]).rows
    end_m = 0.01 * (FRAMES - 1)
    rms_m = 0.01 * np.sqrt(np.mean(np.arange(FRAMES) ** 2))
    assert path.cells[0] == (f"{end_m:.2f}", "0.00", f"{rms_m:.2f}")


def test_seconds_behind_the_cut_before():
    stamps_ns = np.arange(26) * 1_000_000_000
    behind_s = split.seconds_behind(stamps_ns, RUN)
    assert behind_s[:9].tolist() == [-1.0] * 9
    assert behind_s[9:19].tolist() == list(range(10))
    assert behind_s[19:].tolist() == list(range(7))


def test_all_runs_have_a_log_and_a_name_of_their_own(tmp_path):
    runs = runs_of([1, 2], [10.0, 20.0], [0.0, 5.0])
    assert len({run.result(tmp_path) for run in runs}) == len(runs) == 24
    assert len({run.log(tmp_path) for run in runs}) == 6
