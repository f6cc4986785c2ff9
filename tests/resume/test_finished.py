"""``--resume`` finds a finished replay complete, for any start and any transforms."""

from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream import log
from roadperc_stream.chain.encoding import FORMAT_VERSION, encode
from roadperc_stream.cli.replay import main
from roadperc_stream.geometry import rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.model import Transform
from roadperc_stream.output import encoding
from roadperc_stream.resume.checkpoint import checkpoint_folder
from roadperc_stream.schemas.record import STATE_ATTACHMENT
from tests import logs
from tests.analytic import STEP_NS
from tests.resume.parts import with_attachments
from tests.resume.test_continued import ANYHOW, ROAD
from tests.resume.test_kills import interrupt

FRAMES = 12
NAMES = ("map", "odom", "base_link", "mast", "camera", "ego", "lidar")
EVERY = ["--set", "sync.max_wait_s=0.1", "--checkpoint-every", "0.2", "--quiet"]
BEGINNINGS = {"warm-up": ["--start", "0.3", "--warm-up", "0.2"], "continue": ["--start", "0.3", "--continue"]}
OLDER = f"its format has version {FORMAT_VERSION - 1}, expected {FORMAT_VERSION}; "


@st.composite
def transforms(draw):
    """Messages of transforms with their frame numbers; parents come before children in ``NAMES``, so without loops."""
    metres = st.floats(-3, 3)
    return [
        (
            frame,
            [
                Transform(NAMES[draw(st.integers(0, child - 1))], NAMES[child], placed(draw(metres), draw(metres)))
                for child in draw(st.sets(st.integers(1, len(NAMES) - 1), min_size=1, max_size=4))
            ],
        )
        for frame in draw(st.lists(st.integers(0, FRAMES - 1), min_size=1, max_size=6))
    ]


def placed(x_m, yaw):
    return rigid(rotation_from_rpy(0.0, 0.0, yaw), np.array([x_m, 0.0, 1.0]))


def with_transforms(path, made):
    """A log with its own transforms and these."""
    items = logs.items(FRAMES, road=ROAD)
    for frame, edges in made:
        stamp_ns = logs.START_NS + frame * STEP_NS
        items.append(logs.Item("tf", stamp_ns, encoding.encode_transforms(stamp_ns, edges)))
    return logs.write(path, sorted(items, key=lambda item: item.stamp_ns))


def assert_complete(folder, source, beginning):
    target, options = folder / "out.mcap", [*EVERY, *BEGINNINGS[beginning]]
    if beginning == "continue":
        assert main([str(source), str(folder / "before.mcap"), *EVERY, "--end", "0.3"]) == 0
        options.append(str(folder / "before.mcap"))
    assert main([str(source), str(target), *options]) == 0
    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert main([str(source), str(target), *options, "--resume"]) == 0
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize("beginning", BEGINNINGS)
@settings(max_examples=3, **ANYHOW)
@given(made=transforms())
def test_a_finished_replay_is_complete_with_any_transforms(beginning, made):
    with TemporaryDirectory() as folder:
        assert_complete(Path(folder), with_transforms(Path(folder) / "in.mcap", made), beginning)


@settings(max_examples=20, **ANYHOW)
@given(made=transforms(), asked=st.lists(st.sampled_from(NAMES), min_size=2, max_size=8))
def test_lookups_do_not_change_the_bytes_of_a_tree(made, asked):
    tree = TransformTree()
    for _, edges in made:
        tree = tree.updated(edges)
    before = encode(tree)
    for target, source in pairwise(asked):
        tree.lookup(target, source)
    assert encode(tree) == before


@pytest.fixture(scope="module")
def warmed(tmp_path_factory):
    """A warmed-up result."""
    folder = tmp_path_factory.mktemp("warmed")
    source = with_transforms(folder / "in.mcap", [])
    assert main([str(source), str(folder / "out.mcap"), *EVERY, *BEGINNINGS["warm-up"]]) == 0
    return folder / "out.mcap"


def test_a_state_of_an_older_version_is_one_error(warmed, tmp_path, capsys):
    (data,) = (item.data for item in log.summarise(warmed).attachments if item.name == STATE_ATTACHMENT)
    older = with_attachments(warmed, tmp_path / "older.mcap", **{STATE_ATTACHMENT: older_version(data)})
    assert main([str(warmed), str(tmp_path / "new.mcap"), *EVERY, "--continue", str(older)]) == 1
    assert capsys.readouterr().err == f"error: {older}: attachment {STATE_ATTACHMENT}: {OLDER}replay its input again\n"
    assert list(tmp_path.iterdir()) == [older]


def test_a_checkpoint_of_an_older_version_is_one_error(tmp_path, capsys):
    source, target = with_transforms(tmp_path / "in.mcap", []), tmp_path / "out.mcap"
    interrupt(source, target, 10)
    state = checkpoint_folder(target) / "state"
    state.write_bytes(older_version(state.read_bytes()))
    assert main([str(source), str(target), *EVERY, "--resume"]) == 1
    assert capsys.readouterr().err == f"error: {state.parent}: {OLDER}remove it to start over\n"


def older_version(data):
    return data[:7] + bytes([data[7] - 1]) + data[8:]
