"""The first picture of README shows what the chain computes today."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from docs.make_pictures import _SHOWN_FRAME, jpegs
from tests.commands import run_forked

ROOT = Path(__file__).parents[1]


@pytest.mark.long
def test_the_overlay_is_redrawn_as_in_the_picture(tmp_path):
    rendered = re.search(r"roadperc-render \S+/drive (.*) --seconds", (ROOT / "Makefile").read_text())[1].split()
    seconds = ("--seconds", (_SHOWN_FRAME + 1) / 20)
    for command, *arguments in (
        ("roadperc-render", tmp_path / "drive", *rendered, *seconds, "--without", "right"),
        ("roadperc-convert", tmp_path / "drive", tmp_path / "town.mcap"),
        ("roadperc-replay", tmp_path / "town.mcap", tmp_path / "result.mcap", "--overlay"),
    ):
        ended = run_forked(command, *arguments)
        assert ended.returncode == 0, ended.stderr
    drawn = cv2.imdecode(np.frombuffer(jpegs(tmp_path / "result.mcap")[_SHOWN_FRAME], np.uint8), 1)
    apart = np.abs(drawn.astype(int) - cv2.imread(str(ROOT / "docs" / "overlay.jpg")))
    assert apart.mean() < 0.5
    assert (apart > 40).mean() < 0.001
