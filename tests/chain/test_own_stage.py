"""Stages of the user's own: their inputs, their state, the checks of their output, and where their code is from."""

import hashlib
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

import numpy as np
import polars as pl
import pytest

import roadperc_stream as rp
from roadperc_stream import log
from roadperc_stream.chain.encoding import decode, encode
from roadperc_stream.chain.protocols import LanesStage
from roadperc_stream.chain.stages.lanes import ego_lane
from roadperc_stream.chain.stages.lanes.tracking import LanesState
from roadperc_stream.chain.step import State
from roadperc_stream.cli.batch import main as batch_main
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.cli.sweep import main as sweep_main
from roadperc_stream.config import load_config
from roadperc_stream.errors import ConfigError, StageError, StateError
from roadperc_stream.eval.replaying import shown
from roadperc_stream.eval.runs import open_run
from roadperc_stream.geometry import Plane
from roadperc_stream.model import Absent, Boundary, Lanes, Object, Objects, Odometry, Reason, StereoDepth, Surface
from roadperc_stream.output.tables import config_digest, read_footer
from tests import commands
from tests.analytic import Road
from tests.test_api import CAMERA, STEP_NS, road
from tests.test_sample import SAMPLE

DEPTH_M, TAGS = road()
LEFT = Lanes((Boundary("left", "measured", offset_m=1.5, heading=0.0, curvature_per_m=0.0),))
COUNTING = '''
"""Lanes whose left offset is the number of frames."""
from dataclasses import dataclass
from roadperc_stream.model import Boundary, Lanes

class Counting:
    @dataclass(frozen=True)
    class State:
        frames: int = 0

    def __call__(self, cfg, state, scene, road, drivable, motion):
        print("a line of my own")
        state = self.State(state.frames + 1)
        return state, Lanes((Boundary("left", "measured", offset_m=float(state.frames), raw_offset_m=None),))
'''
ONLY = ["--only", "lanes", "--quiet"]
OFF = {name: {"enabled": False} for name in ("odometry", "objects", "occupancy")}
CONFIG = {"sync": {"max_wait_s": 0.05}, "surface": {"model": "plane"}, "stereo": {"method": "off"}, **OFF}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working directory with the module ``counting``; modules imported from it are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    before = set(sys.modules)
    (tmp_path / "counting.py").write_text(COUNTING)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def counting(**more):
    return {**CONFIG, "lanes": {"implementation": "counting:Counting"}, **more}


def stepped(stage, steps=1, name="lanes"):
    chain = rp.Chain(CAMERA, stages={name: stage}, tag_table="0.9.15")
    return [chain.step(k * STEP_NS, depth_m=DEPTH_M, tags=TAGS) for k in range(steps)][-1]


class Remembering:
    @dataclass(frozen=True)
    class State:
        offsets_m: tuple[float, ...] = ()
        template: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def __call__(self, _, state, *inputs):
        assert len(inputs) == 4
        assert not state.template.flags.writeable
        state = self.State((*state.offsets_m, len(state.offsets_m)), state.template + 1)
        return state, Lanes((Boundary("left", "held", offset_m=float(state.template.sum())),))


def test_a_stage_of_ones_own_gets_the_inputs_and_its_state():
    seen = []

    def mine(cfg, state, scene, road, drivable, motion):
        seen.append((cfg.hold_s, state, scene.tags.shape, road.source, drivable.any()))
        return None, LEFT

    stage: LanesStage[None] = mine
    result = stepped(stage, 2)
    assert seen == [(0.5, None, CAMERA.size, "depth", True)] * 2
    assert result.lanes.side("left").offset_m == 1.5
    assert stepped(Remembering, 3).lanes.side("left").offset_m == 6.0


def test_the_saved_state_is_the_state_of_the_next_frame():
    one, other = (rp.Chain(CAMERA, stages={"lanes": Remembering}, tag_table="0.9.15") for _ in range(2))
    for k in range(3):
        result = one.step(k * STEP_NS, depth_m=DEPTH_M, tags=TAGS)
        again = other.step(k * STEP_NS, depth_m=DEPTH_M, tags=TAGS)
        other._state = decode(encode(other._state), State)
        assert str(result.lanes) == str(again.lanes)
    built_in = rp.Chain(CAMERA, tag_table="0.9.15")
    built_in._state = one._state
    with pytest.raises(StateError, match="lanes: its state is that of an own stage"):
        built_in.step(9 * STEP_NS, depth_m=DEPTH_M, tags=TAGS)
    one._state = replace(one._state, lanes=b"\x93\x01")
    with pytest.raises(StageError, match=r"failed in .*: ValidationError: Expected `object`"):
        one.step(9 * STEP_NS, depth_m=DEPTH_M, tags=TAGS)


def returning(state, output):
    return lambda *_: (state, output)


def raising(*_):
    return 1 / 0


def painting(cfg, state, scene, road, drivable, motion):
    drivable[:] = True


def lines(**fields):
    return Lanes((Boundary("left", "measured", **fields),))


HOSTILE = {
    "raises": (raising, r"frame with stamp 0 ns: ZeroDivisionError: division by zero \(.*test_own_stage.py, line"),
    "None": (lambda *_: None, "expected state and output, found None"),
    "wrong arguments": (lambda _: None, "TypeError: .* takes 1 positional argument but 6 were given"),
    "wrong output": (returning(None, "left"), "expected Lanes or Absent, found str"),
    "no lanes": (returning(None, Objects(())), "expected Lanes or Absent, found Objects"),
    "text for a number": (returning(None, lines(offset_m="1.5")), "Expected `float | null`, got `str`"),
    "NaN": (returning(None, lines(offset_m=np.nan)), "Lanes.boundaries.offset_m: expected a finite number or None"),
    "NaN in an array": (returning(None, lines(line_px=np.full((2, 2), np.nan))), "line_px: expected finite numbers"),
    "two left": (returning(None, Lanes(LEFT.boundaries * 2)), "boundaries: expected one for each side"),
    "covariance": (returning(None, lines(covariance=(1.0,))), "covariance: expected 9 numbers or none"),
    "reason": (lambda *_: (None, Absent(Reason("lanes", "tired"))), "KeyError: 'tired'"),
    "changed input": (painting, "ValueError: assignment destination is read-only"),
}  # fmt: skip


@pytest.mark.parametrize(("stage", "message"), HOSTILE.values(), ids=HOSTILE)
def test_a_failing_stage_is_one_clear_error(stage, message):
    with pytest.raises(StageError, match=message) as caught:
        stepped(stage)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("lanes: tests.chain.test_own_stage:")
    if stage is raising:
        assert isinstance(caught.value.__cause__, ZeroDivisionError)


@dataclass
class Thawed:
    frames: int = 0


@dataclass(frozen=True)
class Demanding:
    frames: int


@dataclass(frozen=True)
class Opaque:
    frames: object = field(default_factory=object)


@dataclass(frozen=True)
class Changeable:
    frames: list[int] = field(default_factory=list)
    text: str = ""


def stage_with(state_type, step=lambda *given: (given[1], LEFT)):
    return type("Stage", (), {"State": state_type, "__call__": lambda _, *given: step(*given)})


@pytest.mark.parametrize(
    ("stage", "message"),
    [
        (stage_with(Thawed), "State: expected a frozen dataclass"),
        (stage_with(int), "State: expected a frozen dataclass"),
        (stage_with(Demanding), "missing 1 required positional argument: 'frames'; see roadperc_stream"),
        (stage_with(Opaque), "object has no encoding"),
        (type("Demanding", (), {"__init__": lambda _, x: x}), "Demanding: TypeError: .* missing 1"),
        (type("Silent", (), {}), "expected a class or function, found Silent"),
        ("lanes.py", "expected a class or function, found str"),
    ],
)  # fmt: skip
def test_what_is_no_stage_is_refused_before_the_first_frame(stage, message):
    with pytest.raises(ConfigError, match=message):
        rp.Chain(CAMERA, stages={"lanes": stage})


def test_stages_that_cannot_be_replaced_are_refused():
    with pytest.raises(ConfigError, match="no stage 'occupancy' to replace; expected one of stereo, surface"):
        rp.Chain(CAMERA, stages={"occupancy": raising})


def test_a_stage_can_change_only_its_new_state():
    def growing(cfg, state, *_):
        state.frames.append(1)
        return state, lines(offset_m=float(len(state.frames)))

    chain = rp.Chain(CAMERA, stages={"lanes": stage_with(Changeable, growing)}, tag_table="0.9.15")
    chain.step(0)
    kept = chain._state
    offsets = []
    for _ in range(2):
        chain._state = kept
        offsets.append(chain.step(STEP_NS).lanes.side("left").offset_m)
    assert offsets == [2.0, 2.0]


@pytest.mark.parametrize(
    ("state", "message"),
    [
        (Changeable(text="x" * 70_000_000), "StateError: 700000.. bytes: expected 67108864 at most"),
        (Changeable(frames=["one"]), "Expected `int`, got `str`"),
        (Changeable(text="\ud800"), "UnicodeEncodeError"),
        (Thawed(), "state: expected Changeable, found Thawed"),
    ],
    ids=["large", "wrong type", "no text", "another class"],
)
def test_a_state_that_cannot_be_kept_is_an_error(state, message):
    with pytest.raises(StageError, match=message):
        stepped(stage_with(Changeable, returning(state, LEFT)))


def test_all_stages_can_be_replaced_and_are_written(tmp_path):
    """Constant outputs of surface, stereo, odometry and objects appear in the tables."""
    level = Plane((0.0, -1.0, 0.0), 1.25)
    depth_m = {}

    def surface(cfg, state, scene, rng):
        return None, Surface.of("lower_image", scene.camera, scene.ego_T_camera, level)

    def match(cfg, left, right, ego_T_left, left_image, right_image):
        depth_m.setdefault("size", left.size)
        return StereoDepth(left.frame_id, np.full(left.size, 0.25, np.float32))

    def follow(cfg, state, scene, road, rng):
        assert road.camera_height_m == 1.25
        return None, Odometry("first", np.eye(4))

    def objects(cfg, state, scene, lanes, last_T_this, ground):
        assert scene.bgr.shape == (*CAMERA.size, 3)
        return None, Objects((Object(scene.detections[0], kept=True, distance_m=9.0),))

    stages = {"surface": surface, "stereo": match, "odometry": follow, "objects": objects}
    right = replace(CAMERA, frame_id="right", baseline_m=0.5)
    chain = rp.Chain(CAMERA, stages=stages, right_camera=right, tag_table="0.9.15", ego_T_camera=rp.mounting(z=1.5))
    car = rp.Detection("car", rp.Box(10, 10, 20, 20), 0.5)
    grey = np.zeros(CAMERA.size, np.uint8)
    result = chain.step(0, image=grey, right_image=grey, tags=TAGS, detections=[car])
    assert (result.surface.camera_height_m, result.odometry.status, result.objects.nearest.distance_m) == (
        1.25,
        "first",
        9,
    )
    assert depth_m["size"] == result.stereo.depth_m.shape == CAMERA.size


UP, FORWARD = Plane((0.0, 0.0, 1.0), 1.5), Plane((0.0, -1.0, 0.0), 1.5)
ELSEWHERE = Surface.of("depth", replace(CAMERA, frame_id="x"), np.eye(4), UP)
WILD = Object(rp.Detection("car", rp.Box(9, 0, np.inf, 1), 1.0), kept=True)
WRONG = {
    "surface without a camera": ("surface", ELSEWHERE, "frame_id: expected camera"),
    "surface on its side": ("surface", Surface.of("depth", CAMERA, np.eye(4), FORWARD), "a normal that points up"),
    "scaled pose": ("odometry", Odometry("first", np.diag([2.0, 1, 1, 1])), "odom_T_ego, step: expected rotations"),
    "no step": ("odometry", Odometry("tracked", np.eye(4)), "step, since_ns: expected for a tracked frame"),
    "box": ("objects", Objects((WILD,)), "x_max: expected a finite number"),
}  # fmt: skip


@pytest.mark.parametrize(("name", "output", "message"), WRONG.values(), ids=WRONG)
def test_wrong_outputs_of_other_stages(name, output, message):
    with pytest.raises(StageError, match=f"^{name}: .*{message}"):
        stepped(returning(None, output), name=name)


@pytest.mark.parametrize(
    ("depth_m", "message"),
    [
        (np.ones((2, 3), np.float32), r"expected the shape \(240, 320\), found \(2, 3\)"),
        (np.zeros(CAMERA.size, np.float32), "metres or NaN"),
    ],
)
def test_wrong_stereo_depth(depth_m, message):
    stage = lambda *_: StereoDepth("camera", depth_m)  # noqa: E731 - a stage in one line
    chain = rp.Chain(CAMERA, stages={"stereo": stage}, right_camera=replace(CAMERA, baseline_m=0.5))
    grey = np.zeros(CAMERA.size, np.uint8)
    with pytest.raises(StageError, match=message):
        chain.step(0, image=grey, right_image=grey)


def offsets(path):
    return rp.read_metrics(path)["lane_left_offset_m"].to_list()


def test_a_continued_replay_has_the_state_and_the_source_is_in_the_configuration(folder):
    rp.replay(SAMPLE, "a.mcap", config=counting(), end_s=0.16, threads=2)
    rest = {"start_s": 0.16, "end_s": 0.26, "continued": "a.mcap"}
    rp.replay(SAMPLE, "b.mcap", config=counting(), **rest)
    assert len(offsets("b.mcap")) < 6
    assert offsets(["a.mcap", "b.mcap"]) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    with pytest.raises(StateError, match=r'lanes\.implementation was "counting:Counting", is not set'):
        rp.replay(SAMPLE, "c.mcap", config=counting(lanes={}), **rest)
    digest = hashlib.sha256((folder / "counting.py").read_bytes()).hexdigest()
    attached = {item.name: item.data for item in log.summarise(folder / "a.mcap").attachments}["roadperc.toml"].decode()
    assert f'implementation = "counting:Counting"\nimplementation_source = "sha256 {digest}"' in attached
    facts = read_footer(folder / "a.metrics.parquet").facts
    assert (facts["config"], facts["config_digest"]) == (attached, hashlib.sha256(attached.encode()).hexdigest())
    (folder / "roadperc.toml").write_text(attached)
    assert config_digest(load_config(folder / "roadperc.toml")) == facts["config_digest"]
    (folder / "counting.py").write_text(COUNTING + "\n")
    with pytest.raises(ConfigError, match=r"counting\.py changed: found sha256 .*, expected sha256 .*; restore"):
        rp.replay(SAMPLE, "d.mcap", config="roadperc.toml")


def test_an_own_state_is_warmed_up_and_resumed(folder):
    stopping = "assert state.frames < 5 or not __import__('os').path.exists('stop')\n        return"
    (folder / "counting.py").write_text(COUNTING.replace("return", stopping))
    part = {"config": counting(), "start_s": 0.16, "end_s": 0.46}
    rp.replay(SAMPLE, "warm.mcap", **part, warm_up_s=0.11)
    assert offsets("warm.mcap")[:2] == [4.0, 5.0]
    rp.replay(SAMPLE, "whole.mcap", **part)
    (folder / "stop").touch()
    with pytest.raises(StageError, match="AssertionError"):
        rp.replay(SAMPLE, "resumed.mcap", **part, checkpoint_every_s=0.1)
    (folder / "stop").unlink()
    found = rp.replay(SAMPLE, "resumed.mcap", **part, resume=True)
    assert found.frames_before == 3
    assert (folder / "resumed.mcap").read_bytes() == (folder / "whole.mcap").read_bytes()


def test_built_in_stages_are_not_named_in_the_configuration():
    assert "implementation" not in load_config(None, "lanes.implementation=built-in").to_toml()


def test_a_result_does_not_import_code(folder):
    rp.replay(SAMPLE, "run.mcap", config=counting(), max_frames=2)
    (folder / "run.mcap").unlink()
    del sys.modules["counting"]
    run = open_run(folder / "run.metrics.parquet", "run")
    asked = "lanes.implementation=counting:Counting"
    with ExitStack() as files, pytest.raises(ConfigError, match=f"own; to run its code, pass --set {asked}$"):
        shown(run, 1, {}, "", (), files, lambda *_: None)
    assert "counting" not in sys.modules
    with ExitStack() as files:
        found = shown(run, 1, {}, "", (asked,), files, lambda *_: None)
        assert found.notes == ()
        assert offsets(found.log) == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("x = = 1", "mine:Mine", r"mine cannot be imported: SyntaxError: invalid syntax \(mine.py, line 1\)"),
        ("\nraise OSError('no\\nfile')", "mine:Mine", r"OSError: no file \(.*mine.py, line 2\)"),
        ("import sys; sys.exit(3)", "mine:Mine", "SystemExit: 3"),
        (r"raise OSError('\33[31m')", "mine:Mine", r"OSError: .*\\x1b\[31m"),
        ("import nothing_there", "mine:Mine", "ModuleNotFoundError: No module named 'nothing_there'"),
        ("Mine = 3", "mine:Mine", "mine:Mine: TypeError: expected a class or function, found int"),
        ("", "mine:Mine", "mine.py has no 'Mine'; expected a class or function"),
        ("", "nobody:Mine", "No module named 'nobody'; install it, or run the command in the folder of its file"),
        ("", "mine.sub:Mine", "No module named 'mine.sub'; 'mine' is not a package; install it"),
        ("", "sys:exit", "module sys has no source file"),
        ("", "mine", "expected MODULE:NAME; or built-in, found 'mine'"),
    ],
)  # fmt: skip
def test_code_that_cannot_be_imported_is_one_line(folder, capsys, text, name, message):
    (folder / "mine.py").write_text(text)
    asked = [str(SAMPLE), "out.mcap", "--set", f"lanes.implementation={name}", *ONLY]
    assert replay_main(asked) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert re.match(f"error: lanes.*{message}", line)
    assert not list(folder.glob("*.mcap"))


def test_the_command_finds_a_module_in_its_folder_and_names_the_failing_line(folder):
    (folder / "counting.py").write_text(COUNTING.replace("return", "1 / (2 - state.frames)\n        return"))
    asked = [SAMPLE, "out.mcap", "--set", "lanes.implementation=counting:Counting", "--threads", "2", *ONLY]
    done = commands.run("roadperc-replay", *asked, cwd=folder)
    assert (done.returncode, done.stdout) == (1, "a line of my own\n" * 2)
    assert done.stderr.startswith("error: lanes: counting:Counting failed in frame 1 (stamp ")
    assert done.stderr.endswith(" ns): ZeroDivisionError: division by zero (" + f"{folder / 'counting.py'}, line 14)\n")
    assert not list(folder.glob("*.mcap"))


def is_running(session):
    try:
        os.killpg(session, 0)
    except ProcessLookupError:
        return False
    return True


ASLEEP = "import time; time.sleep(1000)"


STUCK = """
from pathlib import Path

def lanes(*_):
    Path("stuck").touch()
    while True:
        try:
            FOREVER
        except BaseException:
            pass
"""


@pytest.mark.parametrize(
    ("words", "forever"),
    [
        (f"roadperc-replay {SAMPLE} out.mcap --threads 2", ASLEEP),
        (f"roadperc-sweep {SAMPLE} --out out --jobs 2", ASLEEP),
        (f"roadperc-batch out {SAMPLE} --jobs 2", "pass"),
    ],
)
def test_an_endless_stage_can_be_interrupted(folder, words, forever):
    (folder / "stuck.py").write_text(STUCK.replace("FOREVER", forever))
    vary = ["--vary" if "sweep" in words else "--set", "lanes.implementation=stuck:lanes"]
    command, *options = words.split()
    options += [*vary, "--set", "stereo.method=off"]
    process = subprocess.Popen(commands.words(command, *options), stderr=-1, start_new_session=True)
    while process.poll() is None and not (folder / "stuck").exists():
        time.sleep(0.05)
    time.sleep(0.2)
    asked = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=30)
    assert time.monotonic() - asked < 2
    assert process.returncode == 1, error
    assert error.splitlines()[-1].startswith(b"error: interrupted"), error
    assert not list(folder.rglob("*.mcap"))
    while is_running(process.pid):  # a worker
        assert time.monotonic() - asked < 5
        time.sleep(0.05)


def test_batches_and_sweeps_run_own_stages(folder):
    own = "lanes.implementation=counting:Counting"
    only = ["--set", own, "--set", "stereo.method=off", "--frames", "2"]
    assert batch_main(["dataset", str(SAMPLE), *only, "--quiet", "--jobs", "1"]) == 0
    rows = pl.read_parquet("dataset/metrics/**/*.parquet")
    assert rows["lane_left_offset_m"].to_list() == [1.0, 2.0]
    vary = ["--vary", "lanes.implementation=built-in,counting:Counting", "--set", "stereo.method=off"]
    assert sweep_main([str(SAMPLE), *vary, "--out", "sweep", "--frames", "2"]) == 0
    found = [
        pl.read_parquet(path)["lane_left_offset_m"].to_list() for path in sorted(folder.rglob("sweep/0*/*.parquet"))
    ]
    assert found[1] == [1.0, 2.0] != found[0]


class BuiltIn:
    State = LanesState

    def __call__(self, *inputs):
        return ego_lane.step(*inputs)


@pytest.mark.parametrize("rows", [480, 960])
def test_an_own_stage_may_return_what_the_built_in_one_returns(rows):
    """Of large images the edges have half the size."""
    scene = Road(width=rows * 4 // 3, height=rows)
    chain = rp.Chain(scene.camera, ego_T_camera=scene.ego_T_camera, stages={"lanes": BuiltIn}, tag_table="0.9.13")
    result = chain.step(STEP_NS, depth_m=scene.depth_m(), tags=scene.tags())
    assert result.lanes.edges.any()
