"""Every setting has an effect: another value gives another result on the frames of the sample."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import polars as pl
import pytest

from roadperc_stream.chain.step import State
from roadperc_stream.config import STAGES, ReplayConfig, load_config, switched_off
from roadperc_stream.config.fields import Section
from roadperc_stream.config.stages import ABOUT_THE_LOG, OWN_STAGES
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.system.threads import one_thread
from roadperc_stream.system.time import TimeRange
from tests import logs
from tests.chain.test_chain import same
from tests.replaying import replay
from tests.steps import step

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
FRAMES = 8

SURFACE = {
    "seed": "1",
    "surface.enabled": "false",
    "surface.model": "plane",
    "surface.classes": "road",
    "surface.inlier_m": "0.005",
    "surface.hypotheses": "1",
    "surface.max_depth_m": "10",
    "surface.max_tilt_deg": "0.1",
}
SPLINE = {
    "surface.spline_knot_m": "10",
    "surface.spline_curvature_per_m": "0.0005",
    "surface.spline_half_width_m": "4",
}
STEREO = {
    "stereo.method": "full",
    "stereo.disparities": "16",
    "stereo.block_px": "9",
    "stereo.p1": "400",
    "stereo.p2": "2000",
    "stereo.uniqueness_percent": "40",
    "stereo.speckle_px": "0",
    "stereo.refine_px": "0",
    "stereo.min_disparity_px": "8",
}
LANES = {
    "lanes.enabled": "false",
    "lanes.model": "line",
    "lanes.separators": "sidewalk",
    "lanes.median_px": "21",
    "lanes.canny_low": "2000",
    "lanes.canny_high": "2000",
    "lanes.canny_aperture": "5",
    "lanes.hough_rho_px": "4",
    "lanes.hough_threshold": "200",
    "lanes.hough_min_length_px": "200",
    "lanes.hough_max_gap_px": "10",
    "lanes.fit_strip_m": "0.1",
    "lanes.gate": "0.01",
    "lanes.process_noise": "5",
    "lanes.car_width_m": "10",
}
OBJECTS = {
    "objects.enabled": "false",
    "objects.filter": "class_ratio",
    "objects.distance_quantile": "0.5",
    "objects.distance_pixels": "box",
    "objects.hold_s": "0",
    "objects.template_search": "false",
    "objects.carry_after_s": "1",
    "objects.template_min_score": "0.99",
    "objects.min_overlap": "0.9",
    "objects.gate": "0.1",
    "objects.min_distance_std_m": "1",
    "objects.process_noise": "20",
    "objects.max_speed_std_mps": "0.5",
    "objects.car_width_m": "6",
    "objects.path_margin_m": "3",
}
IMPACTS = {"objects.min_closing_mps": "10", "objects.min_closing_sigmas": "1000"}
ODOMETRY = {
    "odometry.enabled": "false",
    "odometry.features": "orb",
    "odometry.min_rows": "100",
    "odometry.min_inliers": "300",
    "odometry.max_speed_mps": "1",
    "odometry.max_turn_rate_dps": "0.1",
}
OCCUPANCY = {
    "occupancy.enabled": "false",
    "occupancy.resolution_m": "0.4",
    "occupancy.x_min_m": "5",
    "occupancy.x_max_m": "20",
    "occupancy.half_width_m": "10",
    "occupancy.min_height_m": "1",
    "occupancy.max_height_m": "1",
    "occupancy.obstacle_classes": "pedestrian",
    "occupancy.pixel_step": "16",
    "occupancy.min_points": "10",
    "occupancy.depth_tolerance": "0.0",
}
ELSEWHERE = {
    "tag_table": "below",
    "sync.tolerance_s": "input/test_sync.py",
    "sync.max_wait_s": "input/test_sync.py",
    "surface.assumed_height_m": "below",
    "surface.hold_m": "tests/chain/stages/surface/test_held_plane.py",
    "lanes.hold_s": "chain/stages/lanes/test_tracking.py",
    "objects.template_png": "chain/stages/objects/test_template.py",
    "objects.template_distance": "chain/stages/objects/test_template.py",
    "objects.cut_in_mps": "chain/stages/objects/test_path.py",
    "objects.restart_s": "chain/stages/objects/test_tracker.py",
    "limits.chunk_mb": "hostile/test_logs.py",
    "limits.record_mb": "hostile/test_logs.py",
    "limits.image_megapixels": "hostile/test_messages.py",
    **{f"{stage}.implementation": "chain/test_own_stage.py" for stage in OWN_STAGES},
    **{f"{stage}.implementation_source": "chain/test_own_stage.py" for stage in OWN_STAGES},
}
"""Settings without an effect on the sample, and the test of each."""

GROUPS = (
    (SURFACE, ("surface",), ()),
    (SPLINE, ("surface",), ("surface.model=spline",)),
    (STEREO, ("stereo",), ()),
    (LANES, ("surface", "lanes"), ()),
    ({"lanes.use_odometry": "false"}, ("surface", "lanes", "odometry"), ()),
    (OBJECTS, ("objects",), ()),
    (IMPACTS, ("objects",), ("objects.path_margin_m=5",)),
    ({"objects.min_class_ratio": "0.9"}, ("objects",), ("objects.filter=class_ratio",)),
    (ODOMETRY, ("odometry",), ()),
    ({"odometry.matcher": "flann"}, ("odometry",), ("odometry.features=sift",)),
    ({"odometry.pitch_std_deg": "0"}, ("surface", "odometry"), ("mono",)),
    (OCCUPANCY, ("surface", "occupancy"), ()),
)


@cache
def frames(mono):
    found = open_input(ReplaySource(SAMPLE, time_range=TimeRange(frames=FRAMES)), ReplayConfig()).samples()
    lacking = {"depth_image": None, "right": None} if mono else {}
    return [replace(sample.frame, **lacking) for sample in found]


@cache
def results(stages, settings):
    others = tuple(switched_off(stage) for stage in STAGES if stage not in stages)
    cfg = load_config(None, (*others, *(s for s in settings if s != "mono")))
    state, found = State(), []
    with one_thread():
        for frame in frames("mono" in settings):
            state, result = step(cfg, state, frame)
            found.append(result)
    return tuple(found)


def all_settings():
    """``section.key``, and the keys that belong to no section; not those of tables about the log."""
    for name, field in ReplayConfig.model_fields.items():
        if name in ABOUT_THE_LOG:
            continue
        if isinstance(field.default, Section):
            yield from (f"{name}.{key}" for key in type(field.default).model_fields)
        else:
            yield name


def test_no_setting_is_left_out():
    shown = [key for changes, _, _ in GROUPS for key in changes]
    assert sorted([*shown, *ELSEWHERE]) == sorted(all_settings())


@pytest.mark.parametrize(
    ("stages", "settings", "change"),
    [
        pytest.param(stages, settings, f"{key}={value}", id=key)
        for changes, stages, settings in GROUPS
        for key, value in changes.items()
    ],
)
def test_another_value_gives_another_result(stages, settings, change):
    assert not same(results(stages, (*settings, change)), results(stages, settings))


def test_a_configured_tag_table_overrides_the_logs(tmp_path):
    """In the configured table, the tag 7 of the log is a traffic light instead of road."""
    source = logs.write(tmp_path / "in.mcap", logs.items(1))
    found = {}
    for name in ("auto", "0.9.15"):
        replay(source, tmp_path / f"{name}.mcap", load_config(None, (f"tag_table={name}",)))
        found[name] = pl.read_parquet(sidecar_path(tmp_path / f"{name}.mcap", "metrics"))["surface_source"].to_list()
    assert found == {"auto": ["depth"], "0.9.15": ["assumed"]}


def test_without_mounting_and_depth_the_camera_has_the_assumed_height(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(2, roles=("calibration", "image", "segmentation")))
    replay(source, tmp_path / "out.mcap", load_config(None, ("surface.assumed_height_m=2.5",)))
    table = pl.read_parquet(sidecar_path(tmp_path / "out.mcap", "metrics"))
    assert table["surface_source"].to_list() == ["assumed", "estimated"]
    assert table["camera_height_m"].to_list() == pytest.approx([2.5] * 2)
