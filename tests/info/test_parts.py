"""roadperc-info shows how several logs follow each other as files of one log."""

import pytest

from roadperc_stream.api import replay
from roadperc_stream.cli.info import main
from roadperc_stream.config import load_config
from roadperc_stream.errors import ChannelError, StateError
from roadperc_stream.info.printing import _is_listed
from roadperc_stream.info.role_states import RoleState
from roadperc_stream.log import LogWriter, Message
from tests import logs
from tests.analytic import Road
from tests.logs import START_NS, STEP_NS


def test_info_prints_how_files_follow_each_other(tmp_path, capsys):
    items = logs.items(12)

    def split(name, first, last):
        kept = [item for item in items if first <= (item.stamp_ns - START_NS) // STEP_NS <= last]
        return str(logs.write(tmp_path / name, kept))

    files = [split("c.mcap", 7, 11), split("a.mcap", 0, 4), split("b.mcap", 3, 5)]
    assert main(files) == 0
    text = capsys.readouterr().out.partition("As files of one log")[2]
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert [line for line in lines if line.split(" ")[0] in ("a.mcap", "b.mcap", "c.mcap")] == [
        "a.mcap 0.000 0.200",
        "b.mcap 0.150 0.250",
        "c.mcap 0.350 0.550",
    ]
    joined = " ".join(lines)
    assert "b.mcap: overlaps a.mcap by 0.050 s" in joined
    assert "c.mcap: begins 0.100 s after b.mcap ends" in joined
    assert "/camera/front/calibration: only in a.mcap" in joined
    assert "together 54 messages on 6 topics over 0.55 s" in joined


def test_json_and_a_single_log_print_nothing_about_joining(tmp_path, capsys):
    path = str(logs.write(tmp_path / "a.mcap", logs.items(2)))
    assert main([path]) == 0
    assert main(["--json", path, path]) == 0
    assert "files of one" not in capsys.readouterr().out


CFG = load_config(None, [f"{stage}.enabled=false" for stage in ("odometry", "lanes", "objects", "occupancy")])


@pytest.fixture
def parts(tmp_path):
    """A log in two files; only the first has calibration and transforms."""
    items, cut_ns = logs.items(6, Road(width=64, height=48)), START_NS + 3 * STEP_NS
    first = logs.write(tmp_path / "part_0.mcap", [item for item in items if item.stamp_ns < cut_ns])
    return first, logs.write(tmp_path / "part_1.mcap", [item for item in items if item.stamp_ns >= cut_ns])


def words_of(capsys, *files):
    assert main(list(map(str, files))) == 0
    return " ".join(capsys.readouterr().out.split())


def test_roles_are_assigned_over_all_files_of_a_log(parts, capsys):
    alone = words_of(capsys, parts[1])
    assert "calibration missing: a replay stops, unless another file of the log has it: the camera is unknown" in alone
    together = words_of(capsys, *parts).partition("As files of one log")[2]
    assert "calibration /camera/front/calibration" in together
    assert "missing" not in together
    with pytest.raises(ChannelError, match=r"pass that file too, or --continue"):
        replay(parts[1], parts[1].with_name("out.mcap"), config=CFG)


def test_a_continued_replay_names_the_earlier_one(parts, capsys):
    results = [path.with_name(f"out_{k}.mcap") for k, path in enumerate(parts)]
    replay(parts[0], results[0], config=CFG)
    replay(parts[1], results[1], config=CFG, continued=results[0])
    text = words_of(capsys, results[1])
    assert "6 frames continues the result of log" in text
    assert "segments" not in text
    together = words_of(capsys, *results).partition("As files of one log")[2]
    assert "out_1.mcap: continues out_0.mcap" in together
    with pytest.raises(StateError, match=r"expected later messages; pass --start"):
        replay(parts[0], parts[0].with_name("out.mcap"), config=CFG, continued=results[0])


def test_two_recordings_in_one_file_are_segments(tmp_path, capsys):
    items = [item for item in logs.items(30, Road(width=64, height=48)) if item.role in {"image", "calibration"}]
    path = tmp_path / "loop.mcap"
    with LogWriter(path) as writer:
        for k in range(2):
            for item in items:
                log_time_ns = item.stamp_ns + 2_000_000_000 * k
                writer.write(Message(logs.channel(item.role), log_time_ns, item.stamp_ns, 0, item.data))
    text = words_of(capsys, path)
    assert "60 frames, one per message of role image" in text
    assert "2 segments: the stamps restart" in text


@pytest.mark.parametrize(
    ("state", "filled", "listed"),
    [
        (RoleState("image", "filled", "/a"), set(), True),
        (RoleState("depth", "missing", cost="no scale"), set(), True),
        (RoleState("lidar", "missing"), set(), False),
        (RoleState("lidar", "missing", candidates=("/points",)), set(), True),
        (RoleState("lidar", "missing", why="damaged"), set(), True),
        (RoleState("left_calibration", "missing", cost="no stereo"), {"left"}, True),
        (RoleState("left_calibration", "missing", cost="no stereo"), {"right"}, False),
        (RoleState("depth_calibration", "missing", cost="no depth"), {"depth"}, True),
        (RoleState("right_calibration", "missing", cost="no stereo"), set(), False),
    ],
)
def test_a_role_is_listed_if_it_is_filled_or_needed(state, filled, listed):
    assert _is_listed(state, filled) == listed
