"""Known answers for the page's series, charts, trajectory and pictures."""

import base64
import json

import cv2
import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.eval.html.charts import distributions, paths, trajectory
from roadperc_stream.eval.html.figures import Series, line, numbers, thinned, wider
from roadperc_stream.eval.html.known_plots import poses_over_time
from roadperc_stream.eval.html.over_time import over_time, stage_times
from roadperc_stream.eval.html.pictures import gallery
from roadperc_stream.eval.runs import find_runs
from roadperc_stream.formats import images
from roadperc_stream.input.stream import Problems
from roadperc_stream.log import Channel, LogWriter, Message
from roadperc_stream.model import Absent, Boundary, Lanes, Object, Objects
from roadperc_stream.output import encoding
from roadperc_stream.output.results import encode_metrics
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.schemas.protobuf import schema
from roadperc_stream.schemas.record import PRODUCER
from roadperc_stream.schemas.topics import METRICS_TOPIC
from roadperc_stream.view.result_frames import read_frame
from tests.analytic import box
from tests.eval.tables import summary_of, write

STAMP = 1_600_000_000_000_000_000


def series(name="drive", **columns):
    values = {key: np.asarray(column, float) for key, column in columns.items()}
    frames = len(next(iter(values.values())))
    return Series(name, np.zeros(frames, np.int64), np.arange(frames) / 20, values)


@given(st.integers(1, 400), st.integers(1, 20), st.integers(0, 2**31))
def test_thinning_keeps_peaks_gaps_ends_and_order(length, buckets, seed):
    rng = np.random.default_rng(seed)
    values = np.where(rng.random(length) < 0.3, np.nan, rng.normal(size=length))
    kept = thinned(values, buckets)
    assert (np.diff(kept) > 0).all()
    assert {0, length - 1} <= set(kept)
    assert len(kept) <= max(3 * buckets + 2, 2)
    assert np.isnan(values[kept]).any() == np.isnan(values).any()
    if np.isfinite(values).any():
        assert np.nanmax(values[kept]) == np.nanmax(values)
        assert np.nanmin(values[kept]) == np.nanmin(values)


def test_numbers_are_valid_json_and_gaps_stay_gaps():
    assert numbers(np.array([1.23456789, np.nan, 1e-9])) == [1.23457, None, 1e-09]
    alone = line("x", np.arange(3.0), np.array([np.nan, 1.0, np.nan]), "#000000")
    assert alone["mode"] == "lines+markers"
    assert line("x", np.arange(3.0), np.array([np.nan, 1.0, 2.0]), "#000000")["mode"] == "lines"


def test_distribution_in_percent_also_of_equal_values():
    (chart,) = distributions([series(stereo_epe_px=[0.5] * 10 + [np.nan])])
    assert (set(chart.traces[0]["x"]), chart.traces[0]["y"][-1]) == ({0.5}, 100)


def poses(which, xy, yaw_deg=0.0):
    half = np.radians(yaw_deg) / 2
    rows = np.asarray(xy, float)
    constant = {"z_m": 0.0, "qx": 0.0, "qy": 0.0, "qz": np.sin(half), "qw": np.cos(half)}
    return {
        f"{which}_x_m": rows[:, 0],
        f"{which}_y_m": rows[:, 1],
        **{f"{which}_{name}": np.full(len(rows), value) for name, value in constant.items()},
    }


def test_the_true_path_starts_at_the_start_of_odometry():
    """The car drives 2 m north in the frame of the truth, 2 m ahead in the odom frame."""
    run = series(**poses("odom", [(0, 0), (1, 0), (2, 0)]), **poses("true", [(100, 50), (100, 51), (100, 52)], 90))
    found = paths(run)
    np.testing.assert_allclose(found["odom"][:, :3], [(0, 0, 0), (1, 0, 0), (2, 0, 0)], atol=1e-9)
    np.testing.assert_allclose(found["true"], found["odom"], atol=1e-9)


def test_truth_that_starts_later_joins_the_path_there():
    later = {name: np.where(np.arange(3) < 1, np.nan, c) for name, c in poses("true", [(9, 9), (7, 7), (8, 7)]).items()}
    found = paths(series(**poses("odom", [(0, 0), (1, 0), (2, 0)]), **later))
    np.testing.assert_allclose(found["odom"][1:, 0], [0, 1], atol=1e-9)
    np.testing.assert_allclose(found["true"][1:, :3], [(0, 0, 0), (1, 0, 0)], atol=1e-9)


def test_plotly_accepts_every_property_of_the_charts():
    run = series(
        **poses("odom", [(0, 0), (1, 0)]),
        **poses("true", [(0, 0), (1, 0)]),
        lane_left_offset_m=[1, 2],
        surface_ms=[1, 1],
        total_ms=[2, 2],
        stereo_epe_px=[1, 2],
    )
    driven = [paths(run)]
    pose_charts = [*trajectory([run], driven), *poses_over_time([run], driven)]
    for chart in [*over_time([run, run]), *stage_times([run]), *pose_charts, *distributions([run])]:
        go.Figure(json.loads(json.dumps(chart.spec, allow_nan=False)))


def result_channel(topic, name):
    found = schema(name)
    return Channel(topic, found.message_encoding, name, found.schema_encoding, found.data, (PRODUCER,))


def image_channel(topic="/camera/front/image"):
    found = schema("foxglove.CompressedImage")
    return Channel(topic, found.message_encoding, found.name, found.schema_encoding, found.data)


LANES = Lanes(
    (
        Boundary("left", "held", (1.0, 48.0, 2.0, 3.0), offset_m=1.5, line_px=np.array([(5.0, 47.0), (6.5, 20.0)])),
        Boundary("right", "lost"),
    )
)
OBJECTS = Objects(
    (
        Object(box("Car", 2, 3, 20, 30), kept=True, class_ratio=0.8, distance_m=7.5, time_to_impact_s=1.25),
        Object(box("Car", 8, 3, 20, 30), kept=False),
    )
)


def write_log(path, late_ns=0, image=True, objects=None, apart_ns=50_000_000):
    """Two frames ``apart_ns`` apart; only the first has results; log times are ``late_ns`` after the stamps."""
    objects = encoding.encode_objects(STAMP, "camera", OBJECTS) if objects is None else objects
    grey = cv2.imencode(".png", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()
    mask = np.zeros((48, 64), np.uint8)
    mask[40:] = 1
    drivable = encoding.encode_image(STAMP, "camera", "png", images.encode_indices(mask, ((0, 0, 0), (0, 200, 80))))
    stamps = (STAMP, STAMP + apart_ns)
    with LogWriter(path) as writer:
        for number, stamp in enumerate(stamps):
            content = encoding.encode_image(stamp, "camera", "png", grey)
            if image:
                writer.write(Message(image_channel(), stamp + late_ns, stamp + late_ns, number, content))
        for topic, name, data in (
            ("/perception/lanes", "roadperc.Lanes", encoding.encode_lanes(STAMP, "camera", LANES)),
            ("/perception/objects", "roadperc.Objects", objects),
            ("/perception/drivable", "foxglove.CompressedImage", drivable),
        ):
            writer.write(Message(result_channel(topic, name), STAMP + late_ns, STAMP + late_ns, 0, data))
        for number, stamp in enumerate(stamps):
            data = encode_metrics("camera", FrameMetrics("a" * 16, number, stamp))
            channel = result_channel("/perception/metrics", "roadperc.FrameMetrics")
            writer.write(Message(channel, stamp + late_ns, stamp + late_ns, number, data))
    return path


@pytest.mark.parametrize("late_ns", [0, 120_000_000])
def test_a_frame_is_read_as_it_was_written(tmp_path, late_ns):
    found = read_frame(write_log(tmp_path / "out.mcap", late_ns), STAMP, Problems())
    assert found.image_bgr.shape == (48, 64, 3)
    assert (found.drivable.sum(), found.drivable[39].any()) == (8 * 64, False)
    left, right = found.lanes.boundaries
    assert (left.side, left.status, right.side, right.status) == ("left", "held", "right", "lost")
    assert left.raw_px == (1.0, 48.0, 2.0, 3.0)
    np.testing.assert_array_equal(left.line_px, LANES.boundaries[0].line_px)
    kept, dropped = found.objects.objects
    assert (kept.kept, kept.class_ratio, kept.distance_m, kept.time_to_impact_s) == (True, 0.8, 7.5, 1.25)
    assert (dropped.kept, dropped.class_ratio, dropped.time_to_impact_s) == (False, None, None)


def test_a_frame_needs_its_own_results_and_image(tmp_path):
    log, right = write_log(tmp_path / "out.mcap"), tmp_path / "right.mcap"
    found = read_frame(log, STAMP + 50_000_000, Problems())
    assert all(isinstance(result, Absent) for result in (found.lanes, found.objects, found.drivable))
    assert read_frame(log, STAMP + 1, Problems()) is None
    assert read_frame(write_log(tmp_path / "none.mcap", image=False), STAMP, Problems()) is None
    with LogWriter(right) as writer:  # results belong to the left camera
        content = encoding.encode_image(STAMP, "right", "png", cv2.imencode(".png", np.zeros((4, 4)))[1].tobytes())
        writer.write(Message(image_channel("/camera/right/image"), STAMP, STAMP, 0, content))
    assert read_frame(right, STAMP, Problems()) is None


def test_pictures_of_a_looped_log_come_from_the_right_segment(tmp_path):
    """Frames of two segments have the same stamp but different pictures."""
    log, table = tmp_path / "loop.mcap", tmp_path / "loop.metrics.parquet"
    rows = [FrameMetrics("a" * 16, k, STAMP, segment=k, lane_left_error_m=0.1 + k) for k in range(2)]
    with LogWriter(log) as writer:
        for item, grey in zip(rows, (40, 200), strict=True):
            picture = cv2.imencode(".png", np.full((48, 64, 3), grey, np.uint8))[1].tobytes()
            content = encoding.encode_image(STAMP, "camera", "png", picture)
            time_ns = STAMP + item.frame * 1_000_000_000
            writer.write(Message(image_channel(), time_ns, time_ns, item.frame, content))
            metrics = result_channel(METRICS_TOPIC, "roadperc.FrameMetrics")
            writer.write(Message(metrics, time_ns, time_ns, item.frame, encode_metrics("camera", item)))
    (run,) = find_runs([str(write(table, rows, log=str(log)))])
    found = gallery(summary_of(run, worst=2).worst["lane_left_error_m"], [run])
    assert found.notes == []
    assert [picture.frame.frame for picture in found.pictures.values()] == [0, 1]
    decoded = [np.frombuffer(base64.b64decode(p.image.partition(",")[2]), np.uint8) for p in found.pictures.values()]
    shades = [int(np.median(cv2.imdecode(data, cv2.IMREAD_COLOR))) for data in decoded]
    assert shades == [pytest.approx(40, abs=3), pytest.approx(200, abs=3)]


def test_a_curve_below_equal_ones_is_wider_so_that_every_run_is_visible():
    values = [np.array([1.0, np.nan, 2.0]), np.array([1.0, np.nan, 2.0]), np.array([1.0, 0.0, 2.0])]
    runs = [
        Series(name, np.zeros(3, int), np.arange(3.0), {"lane_left_offset_m": y})
        for name, y in zip("abc", values, strict=True)
    ]
    first, second, third = (wider(runs, place, "lane_left_offset_m") for place in range(3))
    assert first > second == third == 0
    widths = [trace["line"]["width"] for figure in over_time(runs) for trace in figure.traces]
    assert widths[0] > widths[1] == widths[2]
