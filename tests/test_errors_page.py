"""docs/errors.md shows each error as the command prints it."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadperc_stream.log import LogWriter
from tests import logs
from tests.commands import run_forked

DOCS = Path(__file__).parents[1] / "docs"
SHOWN = re.findall(r"^\$ (.*)\n((?:.+\n)+?)```", (DOCS / "errors.md").read_text("utf-8"), re.MULTILINE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The broken inputs of the page."""
    folder = tmp_path_factory.mktemp("broken")
    write(folder / "in.mcap", logs.ALL)
    write(folder / "no_calibration.mcap", ("tf", "image", "depth"))
    write(folder / "no_segmentation.mcap", logs.ALL, skipped=("segmentation",))
    write(folder / "no_tags.mcap", logs.ALL, metadata=())
    with LogWriter(folder / "empty_bag.mcap") as writer:
        writer.write(logs.foreign())
    (folder / "cut.mcap").write_bytes((folder / "in.mcap").read_bytes()[:-3000])
    (folder / "cut_off.mp4").write_bytes(b"\0\0\0\x1cftypisom\0\0\2\0isomiso2mp41")
    shutil.copy(DOCS / "networks" / "twinlitenet.toml", folder)
    (folder / "empty_folder").mkdir()
    (folder / "drive" / "rgb").mkdir(parents=True)
    cv2.imwrite(str(folder / "drive" / "rgb" / "1.png"), np.zeros((12, 16, 3), np.uint8))
    run_forked("roadperc-replay", "in.mcap", "result.mcap", cwd=folder)
    run_forked("roadperc-replay", "no_segmentation.mcap", "no_segmentation.out.mcap", cwd=folder)
    return folder


def write(path, roles, skipped=(), **labels):
    """Write a log of three frames; the roles in `skipped` have messages in the first frame only."""
    with LogWriter(path) as writer:
        for sequence, item in enumerate(logs.items(3, roles=roles)):
            if item.role not in skipped or item.stamp_ns == logs.START_NS:
                message = logs.message(item, sequence)
                writer.write(replace(message, channel=replace(message.channel, **labels)))


@pytest.mark.parametrize(("command", "shown"), SHOWN, ids=[command for command, _ in SHOWN])
def test_a_command_prints_what_the_page_shows(folder, command, shown):
    done = run_forked(*command.split(), cwd=folder)
    printed = (done.stderr if done.returncode else done.stdout).splitlines()
    assert set(shown.splitlines()) <= {line.rstrip() for line in printed}
