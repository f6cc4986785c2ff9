"""Parts with known answers, joined: the rows of one pass, its numbers, one path, one name for an object."""

import numpy as np
import pytest

from roadperc_stream.batch.joining import POSE, join
from roadperc_stream.errors import TableError
from roadperc_stream.output.tables import facts_in
from roadperc_stream.schemas.columns import TIME_COLUMNS
from tests.batch.tables import (
    NO_POSE,
    drive,
    frame_row,
    object_row,
    part_of_drive,
    pose_row,
    rows_of_poses,
    stamps,
    tables,
)


def column(table, name):
    return table[name].to_pylist()


def path(joined):
    return np.array([joined.metrics[name].to_pylist() for name in POSE], float).T


def expected_path(poses):
    return np.array(rows_of_poses(poses))


def test_one_part_is_itself_but_for_the_logs_name():
    part = part_of_drive(0, drive(7), 0, 7)
    joined = join("whole", [part])
    assert column(joined.metrics, "log_id") == ["whole"] * 7
    assert joined.metrics.drop_columns("log_id").equals(part.metrics.drop_columns("log_id"))
    assert joined.metrics.schema.equals(part.metrics.schema)
    facts = facts_in(joined.metrics.schema.metadata)
    assert facts == facts_in(joined.objects.schema.metadata)
    assert facts == {"log_id": "whole", "source": "/logs/in.mcap", "version": "1"}


@pytest.mark.parametrize("shared", [1, 2, 3, 6, 7])
def test_frames_are_those_of_one_pass_and_the_path_is_whole(shared):
    poses = drive(40)
    parts = [
        part_of_drive(0, poses, 0, 15),
        part_of_drive(1, poses, 15 - shared, 28, shared),
        part_of_drive(2, poses, 28 - shared, 40, shared),
    ]
    joined = join("whole", parts)
    assert column(joined.metrics, "frame") == list(range(40))
    assert column(joined.metrics, "stamp_ns") == stamps(40)
    assert path(joined) == pytest.approx(expected_path(poses), abs=1e-9)
    assert joined.notes == ()
    assert joined.metrics.column_names[-len(TIME_COLUMNS) :] == list(TIME_COLUMNS)
    assert len(joined.objects) == 0


def test_the_seam_lies_in_the_middle_of_what_both_have():
    poses = drive(30)
    parts = [
        part_of_drive(0, poses, 0, 20, lane_proposals=[0] * 20),
        part_of_drive(1, poses, 13, 30, 7, lane_proposals=[1] * 17),
    ]
    assert column(join("whole", parts).metrics, "lane_proposals") == [0] * 17 + [1] * 13


def test_frames_that_only_one_part_has_in_the_overlap_do_not_move_the_seam():
    """The first ones of a part, and the last ones of the one before, may lack a message that came late."""
    poses, late = drive(30), 12
    first = part_of_drive(0, poses, 0, 20)
    second = part_of_drive(1, poses, 10, 30, 10)
    rows = second.metrics.to_pylist()
    rows[late - 10]["stamp_ns"] -= 1  # another frame than the one before has there
    second = tables(1, rows, shared=10)
    joined = join("whole", [first, second])
    assert column(joined.metrics, "stamp_ns") == stamps(30)


def test_changes_of_lane_and_segments_go_on_counting():
    poses = drive(30)
    first = part_of_drive(0, poses, 0, 16, lane_changes=[0] * 5 + [1] * 8 + [2] * 3, segment=[3] * 16)
    second = part_of_drive(
        1, poses, 12, 30, 4, lane_changes=[0, 1, 1, 1, None, *([1] * 8), *([2] * 5)], segment=[0] * 18
    )
    joined = join("whole", [first, second])
    assert column(joined.metrics, "lane_changes") == [0] * 5 + [1] * 8 + [2] * 3 + [None] + [2] * 8 + [3] * 5
    assert column(joined.metrics, "segment") == [3] * 30


def test_behind_a_jump_back_in_time_all_is_as_the_part_has_it():
    """There the chain begins anew in one pass, too: path, changes of lane and names of tracks count from there."""
    poses, again = drive(30), [1_000_000_000 - 5_000_000_000 + k * 100_000_000 for k in range(6)]
    first = part_of_drive(0, poses, 0, 16, lane_changes=[2] * 16)
    rows = part_of_drive(1, poses, 12, 24, 4, lane_changes=[1] * 12).metrics.to_pylist()
    rows += [
        frame_row(12 + k, stamp_ns, row, segment=1, lane_changes=0)
        for k, (stamp_ns, row) in enumerate(zip(again, rows_of_poses(poses[:6]), strict=True))
    ]
    objects = [object_row(11, rows[11]["stamp_ns"], "1", 20.0), object_row(13, again[1], "1", 90.0)]
    seen_before = [object_row(3, stamps(4)[3], "7", 200.0)]
    first = tables(0, first.metrics.to_pylist(), seen_before)
    joined = join("whole", [first, tables(1, rows, objects, shared=4)])
    assert column(joined.metrics, "frame") == list(range(30))
    assert column(joined.metrics, "segment") == [0] * 24 + [1] * 6
    assert column(joined.metrics, "lane_changes") == [2] * 24 + [0] * 6
    assert path(joined)[:24] == pytest.approx(expected_path(poses[:24]), abs=1e-9)
    assert path(joined)[24:].tolist() == np.array(rows_of_poses(poses[:6])).tolist()
    assert column(joined.objects, "track_id") == ["7", "8", "1"]
    assert column(joined.objects, "frame") == [3, 23, 25]


def test_a_jump_in_the_overlap_is_joined_on_its_later_or_its_earlier_side():
    poses = drive(10)
    back = [500_000_000 + k * 100_000_000 for k in range(10)]
    before = [frame_row(k, s, row) for k, (s, row) in enumerate(zip(stamps(10), rows_of_poses(poses), strict=True))]
    after = [
        frame_row(10 + k, s, row, segment=1) for k, (s, row) in enumerate(zip(back, rows_of_poses(poses), strict=True))
    ]
    first = tables(0, [*before, *after[:4]])
    cut = [
        frame_row(k, s, row) for k, (s, row) in enumerate(zip(stamps(10)[6:], rows_of_poses(poses[6:]), strict=True))
    ]
    second = tables(1, [*cut, *({**row, "frame": row["frame"] - 6} for row in after)], shared=8)
    joined = join("whole", [first, second])
    assert column(joined.metrics, "frame") == list(range(20))
    assert column(joined.metrics, "segment") == [0] * 10 + [1] * 10
    assert path(joined) == pytest.approx(np.tile(expected_path(poses), (2, 1)), abs=1e-9)


def test_a_log_played_in_a_loop_is_joined_where_the_parts_overlap():
    """Every stamp comes in each loop: the longest run of equal stamps is not the overlap."""
    loop = stamps(10)
    whole = [frame_row(k, loop[k % 10], segment=k // 10) for k in range(35)]
    second = [{**row, "frame": k, "segment": row["segment"] - 2} for k, row in enumerate(whole[22:])]
    joined = join("whole", [tables(0, whole[:28]), tables(1, second, shared=6)])
    assert column(joined.metrics, "frame") == list(range(35))
    assert column(joined.metrics, "segment") == [k // 10 for k in range(35)]


def test_stamps_that_stand_still_lose_and_double_no_frame():
    whole = [frame_row(k, 5) for k in range(30)]
    second = [{**row, "frame": k} for k, row in enumerate(whole[14:])]
    joined = join("whole", [tables(0, whole[:20]), tables(1, second, shared=6)])
    assert column(joined.metrics, "frame") == list(range(30))


def test_the_path_goes_on_by_a_frame_that_both_know():
    """The pose of a lost frame is an older one: in another part it stands for another place."""
    poses = drive(30)
    first, second = part_of_drive(0, poses, 0, 20), part_of_drive(1, poses, 12, 30, 8)
    rows = first.metrics.to_pylist()
    for k in (16, 17):
        rows[k] |= dict(zip(POSE, pose_row(np.linalg.inv(poses[0]) @ poses[15]), strict=True)) | {
            "odometry_status": "lost"
        }
    joined = join("whole", [tables(0, rows), second])
    assert path(joined)[17:] == pytest.approx(expected_path(poses)[17:], abs=1e-9)
    assert joined.notes == ()


def test_where_odometry_is_lost_all_along_the_path_goes_on_at_the_last_pose():
    poses = drive(30)
    rows = part_of_drive(0, poses, 0, 20).metrics.to_pylist()
    for lost in rows[10:]:
        lost.update({name: rows[9][name] for name in POSE}, odometry_status="lost", step_m=None)
    first, second = tables(0, rows), part_of_drive(1, poses, 14, 30, 6)
    joined = join("whole", [first, second])
    seam = 17
    assert path(joined)[: seam + 1] == pytest.approx(
        np.array([[row[name] for name in POSE] for row in rows[: seam + 1]])
    )
    moved = poses[9] @ np.linalg.inv(poses[seam])
    assert path(joined)[seam + 1 :] == pytest.approx(
        np.array([pose_row(np.linalg.inv(poses[0]) @ moved @ pose) for pose in poses[seam + 1 :]]), abs=1e-9
    )
    (note,) = joined.notes
    assert note.startswith("part 2, from 1 s on: odometry is lost")


def test_without_odometry_there_is_no_path_and_nothing_to_say():
    rows = [frame_row(k, stamp_ns) for k, stamp_ns in enumerate(stamps(20))]
    second = [{**row, "frame": k} for k, row in enumerate(rows[10:])]
    joined = join("whole", [tables(0, rows[:14]), tables(1, second, shared=4)])
    assert [column(joined.metrics, name) for name in POSE] == [[None] * 20] * 7
    assert joined.notes == ()


def test_frames_without_a_pose_stay_without_one():
    poses = drive(30)
    rows = part_of_drive(1, poses, 12, 30, 6).metrics.to_pylist()
    rows[15] |= dict(zip(POSE, NO_POSE, strict=True)) | {"odometry_status": None}
    joined = join("whole", [part_of_drive(0, poses, 0, 18), tables(1, rows, shared=6)])
    assert [column(joined.metrics, name)[27] for name in POSE] == list(NO_POSE)
    assert path(joined)[28:] == pytest.approx(expected_path(poses)[28:], abs=1e-9)


def test_a_path_without_metres_is_joined_to_scale():
    """Each part then counts in units of its own first step."""
    poses = drive(30)
    first = part_of_drive(0, poses, 0, 20, step_m=[None] * 20)
    rows = part_of_drive(1, poses, 10, 30, 10, step_m=[None] * 20).metrics.to_pylist()
    for row in rows:
        row |= {name: row[name] / 7 for name in POSE[:3]}
    joined = join("whole", [first, tables(1, rows, shared=10)])
    assert path(joined) == pytest.approx(expected_path(poses), abs=1e-9)


def frames_with_objects(index, begin, end, seen, shared=0):
    """``seen`` is (track_id, x_px) by frame of the whole log."""
    times = stamps(end - begin, begin)
    objects = [
        object_row(k, stamp_ns, track_id, x_px)
        for k, stamp_ns in enumerate(times)
        for track_id, x_px in seen.get(begin + k, ())
    ]
    return tables(index, [frame_row(k, stamp_ns) for k, stamp_ns in enumerate(times)], objects, shared)


def test_an_object_keeps_its_name_and_a_new_one_gets_a_new_name():
    first = frames_with_objects(0, 0, 12, {k: [("1", 10.0), ("4", 100.0)] for k in range(12)})
    seen = {k: [("2", 100.0), (None, 300.0), ("1", 10.0)] for k in range(8, 14)} | {14: [("3", 200.0), ("1", 10.0)]}
    joined = join("whole", [first, frames_with_objects(1, 8, 16, seen, 4)])
    assert (
        column(joined.objects, "frame")
        == sorted(k for k in range(11) for _ in range(2)) + [11] * 3 + [12] * 3 + [13] * 3 + [14] * 2
    )
    assert column(joined.objects, "track_id")[:22] == ["1", "4"] * 11
    assert column(joined.objects, "track_id")[22:] == ["4", None, "1"] * 3 + ["5", "1"]
    assert set(column(joined.objects, "log_id")) == {"whole"}


def test_a_number_of_an_object_that_is_gone_is_not_given_again():
    first = frames_with_objects(0, 0, 12, {2: [("9", 10.0)]})
    second = frames_with_objects(1, 8, 22, {}, 4)
    third = frames_with_objects(2, 18, 30, {25: [("1", 10.0)], 26: [("2", 10.0)]}, 4)
    assert column(join("whole", [first, second, third]).objects, "track_id") == ["9", "10", "11"]


def test_other_columns_and_parts_without_a_common_frame_are_refused():
    poses = drive(40)
    first, second = part_of_drive(0, poses, 0, 15), part_of_drive(1, poses, 20, 40, 4)
    with pytest.raises(TableError, match=r"part 2, from 1 s on: expected 4 frames that the part before has too"):
        join("whole", [first, second])
    other = part_of_drive(1, poses, 11, 40, 4)
    other = type(other)(other.part, other.metrics.drop_columns("step_m"), other.objects)
    with pytest.raises(TableError, match="expected the columns of the part before"):
        join("whole", [first, other])
