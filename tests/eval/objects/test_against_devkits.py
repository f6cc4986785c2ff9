"""The figures equal those of nuscenes-devkit and trackeval, which need an older numpy, so they run apart.

``ROADPERC_DEVKITS`` is the Python of an environment with ``pip install nuscenes-devkit trackeval``; without it the test
skips.
"""

import json
import os
import subprocess
from pathlib import Path

import pytest

from roadperc_stream.eval.objects.figures import detected, tallies
from roadperc_stream.eval.report.sources import load, source_of_runs
from roadperc_stream.eval.report.summaries import groups_of_runs
from tests.eval.objects.scenes import random_scene, write_scene
from tests.eval.tables import run_of

pytestmark = pytest.mark.skipif(
    "ROADPERC_DEVKITS" not in os.environ,
    reason="no nuscenes-devkit and trackeval: ROADPERC_DEVKITS names no Python that has them",
)

AGREEMENT = 1e-6
SCENES = 100


@pytest.fixture(scope="module")
def scenes():
    return [random_scene(seed) for seed in range(SCENES)]


@pytest.fixture(scope="module")
def expected(scenes, tmp_path_factory):
    """The figures of the devkits for each scene and class."""
    program = [os.environ["ROADPERC_DEVKITS"], Path(__file__).with_name("devkits.py")]
    home = {"HOME": str(tmp_path_factory.mktemp("home")), "PATH": os.environ["PATH"], "MPLBACKEND": "agg"}
    run = subprocess.run(program, input=json.dumps(scenes), capture_output=True, text=True, env=home, check=False)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


def tally_of_class(folder, scene, name):
    """The tally of the objects of one class."""
    frames = load(source_of_runs([run_of(write_scene(folder, scene | {"classes": {name: scene["classes"][name]}}))]))
    (tally,) = tallies(frames, groups_of_runs(frames, ["all"]))
    return tally


def test_hundred_random_scenes_have_the_devkits_figures(scenes, expected, tmp_path):
    compared = 0
    for scene, of_scene in zip(scenes, expected, strict=True):
        for name, figures in of_scene.items():
            tally = tally_of_class(tmp_path, scene, name)
            found = detected(tally, name)
            if not scene["classes"][name][0]:
                assert found is None
                continue
            assert found.precision == pytest.approx(figures["precision"], abs=AGREEMENT)
            assert (found.off_m, found.off_mps) == pytest.approx((figures["off_m"], figures["off_mps"]), abs=AGREEMENT)
            tracks = {key: figures[key] for key in ("hota", "deta", "assa", "mota", "idf1")}
            assert tally.tracks.figures == pytest.approx(tracks, abs=AGREEMENT)
            assert tally.tracks.switched == figures["switched"]
            compared += 1
    assert compared > SCENES
