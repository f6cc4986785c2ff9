"""The height field on rendered hills of known height. The long form runs with ``make accuracy-long``."""

from pathlib import Path

import numpy as np
import pytest

from roadperc_stream.chain.stages.surface.road import drivable_mask, fit_surface
from roadperc_stream.cli import convert, render
from roadperc_stream.config import ReplayConfig, load_config
from roadperc_stream.geometry.ground import height_at
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.metrics.surface import surface_height_error_m
from roadperc_stream.model import Absent
from roadperc_stream.model.frame import Frame

HILL = ("--scene", "hill", "--depth-noise", "0.01")
MODELS = {model: load_config(None, (f"surface.model={model}",)).surface for model in ("plane", "spline")}


def rendered(folder: Path, *options):
    """Samples of a rendered scene."""
    assert render.main([str(folder / "dump"), *options]) == 0
    assert convert.main([str(folder / "dump"), str(folder / "in.mcap"), "--quiet"]) == 0
    return open_input(ReplaySource(folder / "in.mcap"), ReplayConfig()).samples()


def errors_of(folder, *options):
    """(3, frames) for each model: height error, largest error up to 60 m ahead, share of the road found drivable."""
    rows = {model: [] for model in MODELS}
    for sample in rendered(folder, *options):
        frame, truth = sample.frame, sample.truth.surface
        depth_m, tags = frame.depth_image.depth_m, frame.segmentation.tags
        for model, cfg in MODELS.items():
            table, rng = frame.segmentation.table, np.random.default_rng(sample.index)
            road = table.lookup(cfg.classes)[tags]
            depth = {"raw_depth_m": depth_m, "depth_limit_m": frame.depth_image.limit_m}
            scene = Frame.of(1, frame.camera, frame.ego_T_camera, tags=tags, table=table, **depth)
            surface = fit_surface(cfg, scene, road.astype(bool), rng)
            assert not isinstance(surface, Absent)
            assert surface.model == model
            mask = drivable_mask(cfg, scene, surface)
            x, y = np.meshgrid(np.arange(61.0), np.arange(-3.0, 4.0))
            worst = np.abs(height_at(surface, x, y) - height_at(truth, x, y)).max()
            rows[model].append((surface_height_error_m(surface, truth), worst, mask.sum() / road.sum()))
    for model, values in rows.items():
        error, worst, share = np.array(values).T
        heights = f"height at 5 to 40 m: median {np.median(error):.4f}, worst frame {error.max():.4f}"
        rest = f"to 60 m at most {worst.max():.2f} m; drivable {share.min():.1%} of road"
        print(f"\n{' '.join(options)}: {model}, {len(error)} frames: {heights}, {rest}")
    return (np.array(rows[model]).T for model in ("plane", "spline"))


LONG = ("--seconds", "20", "--rate", "2")


@pytest.mark.parametrize(("options", "worst_m", "least_share"), [
    (("--size", "480x360", "--seconds", "1.5", "--rate", "2"), 0.5, 0.99),
    pytest.param(LONG, 2.0, 0.95, marks=pytest.mark.accuracy),
    pytest.param((*LONG, "--tag-noise", "0.05", "--seed", "1"), 2.0, 0.95, marks=pytest.mark.accuracy),
])  # fmt: skip
def test_heights_on_the_hill(tmp_path, options, worst_m, least_share):
    (plane, _, _), (spline, worst, share) = errors_of(tmp_path, *HILL, *options)
    assert np.median(spline) < min(0.05, np.median(plane) / 3)
    assert spline.max() < 0.05
    assert worst.max() < worst_m
    assert share.min() > least_share


@pytest.mark.accuracy
def test_heights_in_the_bends_of_the_town(tmp_path):
    options = ("--scene", "town", "--depth-noise", "0.01", "--tag-noise", "0.02", "--seconds", "20", "--rate", "1")
    (plane, _, _), (spline, _, _) = errors_of(tmp_path, *options)
    assert np.median(spline) < min(0.05, np.median(plane) / 3)
