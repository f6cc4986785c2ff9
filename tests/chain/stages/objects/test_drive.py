"""Closing speed, time to impact and objects tracked by template on rendered drives, where the truth is known."""

import numpy as np
import pytest

from roadperc_stream.cli import render
from roadperc_stream.config import ObjectsConfig
from tests.chain.stages.objects.drive import camera_of, through, well_visible

CFG = ObjectsConfig()
NOISE = ("--tag-noise", "0.02", "--depth-noise", "0.01", "--rgb-noise", "3")
IMPACT_MPS = 2.0
"""From this true closing speed on a time to impact is compared."""


def rendered(folder, *options):
    assert render.main([str(folder / "dump"), "--size", "640x480", *options]) == 0
    return folder / "dump"


class Figures:
    """Errors over the well visible near objects beside their coverage, and what the image search adds."""

    def __init__(self, dump):
        camera, drive = camera_of(dump), through(CFG, dump)
        near = [f for f in drive.found if f.item.status == "measured" and well_visible(f, camera)]
        known = [f for f in near if f.item.closing_speed_mps is not None]
        self.near, self.coverage = len(near), len(known) / len(near)
        self.errors = np.array([f.item.closing_speed_mps - f.truth["closing_speed_mps"] for f in known])
        self.deviations = self.errors / [f.item.closing_speed_std_mps for f in known]
        closing = [f for f in near if f.truth["closing_speed_mps"] > IMPACT_MPS]
        timed = [f for f in closing if f.item.time_to_impact_s is not None]
        self.impact_coverage = len(timed) / len(closing)
        self.impact_errors = np.array([self.impact_error(f) for f in timed])
        coasted = [f for f in drive.found if f.item.status == "tracked"]
        self.coasted, self.coasted_right = len(coasted), sum(f.truth is not None for f in coasted)
        truths = sum(len(truths) for truths in drive.truths)
        self.detected, self.tracked = (
            len({(f.frame, f.truth["id"]) for f in drive.found if f.truth and f.item.status in statuses}) / truths
            for statuses in (("measured",), ("measured", "tracked"))
        )

    @staticmethod
    def impact_error(found):
        """Relative."""
        true_s = found.truth["distance_m"] / found.truth["closing_speed_mps"]
        return found.item.time_to_impact_s / true_s - 1

    def __str__(self):
        error, deviation, impact = (np.abs(e) for e in (self.errors, self.deviations, self.impact_errors))
        return (
            f"closing speed: median {np.median(error):.3f} p90 {np.quantile(error, 0.9):.3f} m/s, coverage "
            f"{self.coverage:.0%} of {self.near}; in deviations median {np.median(deviation):.2f} p95 "
            f"{np.quantile(deviation, 0.95):.2f}\n  time to impact: median {np.median(impact):.1%} p90 "
            f"{np.quantile(impact, 0.9):.1%}, coverage {self.impact_coverage:.0%}\n  tracked by template: "
            f"{self.coasted_right} of {self.coasted} right; found of what is visible {self.detected:.1%} detected, "
            f"{self.tracked:.1%} with those tracked by template"
        )


def test_short_closing_speed_of_near_objects(tmp_path):
    figures = Figures(rendered(tmp_path, "--scene", "straight", "--seconds", "2"))
    assert np.median(np.abs(figures.errors)) < 0.25
    assert figures.coverage > 0.85
    assert np.median(np.abs(figures.impact_errors)) < 0.03
    assert figures.tracked > figures.detected
    assert figures.coasted_right > 0.7 * figures.coasted


@pytest.mark.accuracy
@pytest.mark.parametrize("seed", ["0", "1", "2"])
@pytest.mark.parametrize(
    ("options", "limit_mps"),
    [(("--scene", "straight"), 0.25), (("--scene", "town", *NOISE), 0.35), (("--scene", "town", "--static"), 0.25)],
    ids=["straight", "town, noise", "town, static"],
)
def test_closing_speed_of_near_objects(tmp_path, options, limit_mps, seed):
    figures = Figures(rendered(tmp_path, *options, "--seconds", "5", "--seed", seed))
    print(f"\n{' '.join(options)} --seed {seed}\n  {figures}")
    assert np.median(np.abs(figures.errors)) < limit_mps
    assert figures.coverage > 0.85
    assert figures.tracked >= figures.detected
