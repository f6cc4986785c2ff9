"""A camera that sends the same image while the car moves on: no odometry, and a note. A standing car is not frozen."""

from dataclasses import replace
from pathlib import Path

import pytest

from roadperc_stream.chain.step import State
from roadperc_stream.config import STAGES, load_config, switched_off
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.model import Absent, Reason
from roadperc_stream.system.time import TimeRange
from tests import logs
from tests.analytic import STEP_NS
from tests.replaying import replay
from tests.resume.parts import assert_same_rows, cut, replayed, rows, write
from tests.resume.test_kills import interrupt, same
from tests.steps import step

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
CFG = load_config(None, tuple(switched_off(stage) for stage in STAGES if stage not in ("surface", "odometry")))
FROZEN = Absent(Reason("odometry", "image_frozen"))
BESIDE = {"pose_mark": None, "depth_image": None, "segmentation": None, "detections": None}


@pytest.fixture(scope="module")
def sample():
    frames = open_input(ReplaySource(SAMPLE, time_range=TimeRange(frames=9)), CFG).samples()
    return [replace(found.frame, right=None) for found in frames]


def odometry(frames):
    state, found = State(), []
    for frame in frames:
        state, result = step(CFG, state, frame)
        found.append(result.odometry)
    return found


def with_image_of(frames, first, last):
    """The frames, the image of the first one up to the last one."""
    return [replace(frame, image=frames[first].image) if first < k <= last else frame for k, frame in enumerate(frames)]


@pytest.mark.parametrize("kept", [("pose_mark",), ("depth_image",), ("segmentation",), ("detections",), tuple(BESIDE)])
def test_odometry_is_null_while_the_image_repeats_and_covers_the_whole_way_afterwards(sample, kept):
    frames = with_image_of(
        [replace(frame, **{name: None for name in BESIDE if name not in kept}) for frame in sample], 2, 7
    )
    found = odometry(frames)
    assert [k for k, motion in enumerate(found) if motion == FROZEN] == [3, 4, 5, 6, 7]
    assert found[8].status == "tracked"
    if "depth_image" in kept:
        assert found[8].odom_T_ego[0, 3] == pytest.approx(odometry(sample)[8].odom_T_ego[0, 3], abs=0.05)


@pytest.mark.parametrize("known", [(), ("pose_mark",), ("depth_image", "segmentation", "detections")])
def test_a_standing_car_is_not_frozen(sample, known):
    """All that is known beside the image is constant. Noise in the depth says nothing if the pose is constant."""
    beside = {name: getattr(sample[2], name) if name in known else None for name in BESIDE}
    beside |= {"depth_image": sample[2].depth_image} if "pose_mark" not in known else {"depth_image": None}
    standing = [replace(frame, image=sample[2].image, **beside) for frame in sample]
    if "pose_mark" in known:
        standing = [
            replace(frame, depth_image=other.depth_image) for frame, other in zip(standing, sample, strict=True)
        ]
    assert FROZEN not in odometry(standing)


def test_an_image_that_shows_nothing_is_still_said_to(sample):
    black = replace(sample[0].image, decode_grey=lambda: sample[0].image.grey * 0)
    found = odometry([replace(frame, image=black if k else frame.image) for k, frame in enumerate(sample)])
    assert {motion.reason.code for motion in found[1:]} == {"image_uniform"}


SMALL = load_config(None, ("sync.max_wait_s=0.1",))


RESUMED = {"checkpoint_every_s": 0.2, "resume": True}


ROAD = replace(logs.SMALL, width=96, height=72)


@pytest.fixture(scope="module")
def frozen():
    """Messages of 18 frames; the images 8 to 14 are equal."""
    items = logs.items(18, road=ROAD)
    stuck = [logs.frame_items(logs.START_NS + k * STEP_NS, logs.shifted(ROAD, 8))[0] for k in range(9, 15)]
    by_stamp = {item.stamp_ns: item for item in stuck}
    made = [by_stamp.get(item.stamp_ns, item) if item.role == "image" else item for item in items]
    return [logs.message(item, number) for number, item in enumerate(made)]


@pytest.fixture(scope="module")
def whole(frozen, tmp_path_factory):
    target = tmp_path_factory.mktemp("whole") / "out.mcap"
    return target, replay(write(target.with_name("in.mcap"), frozen), target, SMALL)


def notes_on_frames(summary):
    return [note for note in summary.throughout if "repeats" in note]


def test_a_note_counts_the_frames_and_their_odometry_is_null(whole):
    target, summary = whole
    (note,) = notes_on_frames(summary)
    assert note.startswith("in 6 of 18 frames: odometry: its image repeats")
    found = rows([target], "metrics")
    assert [k for k, status in enumerate(found["odometry_status"]) if status is None] == list(range(9, 15))
    assert found[9:15].select("odom_x_m", "step_m", "turn_deg").null_count().row(0) == (6, 6, 6)
    assert all("odometry.image_frozen" in codes for codes in found["reason_codes"][9:15])


def test_continued_and_resumed_replays_know_that_the_image_repeats(frozen, whole, tmp_path):
    target, summary = whole
    ends = [logs.START_NS + k * STEP_NS + 1 for k in (10, 13)]
    assert_same_rows(rows(replayed(tmp_path, cut(frozen, ends), SMALL), "metrics"), rows([target], "metrics"))
    again = tmp_path / "again.mcap"
    interrupt(target.with_name("in.mcap"), again, 15, SMALL)
    assert notes_on_frames(replay(target.with_name("in.mcap"), again, SMALL, **RESUMED)) == notes_on_frames(summary)
    assert same(again, target)
