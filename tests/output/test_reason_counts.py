"""Reasons of one kind are counted together, and a replay reports those that held in all frames."""

import pytest

from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.model import Reason
from roadperc_stream.output.reason_counts import ReasonCount, grouped, merged, of_frame, ranked, throughout
from tests import logs

FILLED = ("image", "calibration", "segmentation")
TILTED = "surface: the points' plane is tilted by {} degrees, expected at most 30"
SIZE = "image: 520x360 pixels, its calibration says 640x480"


def found(*texts):
    """The reasons of one frame, as a table has them."""
    return grouped(dict.fromkeys(texts, 1))


def test_texts_that_differ_in_numbers_are_one_kind_and_the_commonest_stands_for_it():
    (count,) = grouped({TILTED.format(3): 1, TILTED.format(-12): 4}).values()
    assert count == ReasonCount(TILTED.format(-12), 5, varies=True)
    assert str(count) == f"{TILTED.format(-12)} (numbers vary)"


def test_the_same_text_twice_does_not_vary():
    (count,) = merged([found(SIZE), found(SIZE)]).values()
    assert count == ReasonCount(SIZE, 2)
    assert str(count) == SIZE


def test_a_reason_varies_for_good():
    first, second = found(TILTED.format(1)), found(TILTED.format(2))
    assert next(iter(merged([first, second, first]).values())) == ReasonCount(TILTED.format(1), 3, varies=True)
    assert merged([merged([first, second, first]), first]) == merged([first, merged([first, second, first])])


def test_reasons_of_a_frame_and_those_read_back_are_the_same():
    reasons = (Reason("image", "wrong_size", (520, 360, 640, 480)), Reason("surface", "plane_tilted", (90.0, 30.0)))
    assert of_frame(reasons) == found(SIZE, TILTED.format(90))


def test_the_most_frequent_come_first_and_inputs_before_stages():
    lanes, image, drivable = "lanes: no segmentation", SIZE, "drivable: neither depth nor segmentation"
    whole = merged([found(lanes, image, drivable), found(lanes)])
    assert [count.text for count in ranked(whole).values()] == [lanes, image, drivable]


@pytest.mark.parametrize(
    "text",
    [
        "stereo: no right image",
        "drivable: neither depth nor segmentation",
        "objects: no detections",
        "surface: no depth, the assumed height gives the plane",
        "lanes: no drivable surface: neither depth nor segmentation",
        "lanes: switched off",
        "lanes: no surface: switched off",
    ],
)
def test_what_the_log_lacks_or_the_user_switched_off_is_not_reported(text):
    assert throughout(found(text), 1, FILLED) == ()


def test_what_held_in_all_frames_is_reported_and_nothing_else():
    late = "depth: no message at this frame"
    whole = merged([found(SIZE, late), found(SIZE)])
    assert throughout(whole, 2, FILLED) == (f"in all 2 frames: {SIZE}",)
    assert throughout(found(SIZE), 1, FILLED) == (f"in the only frame: {SIZE}",)


def test_messages_that_cannot_be_used_in_some_frames_are_reported():
    whole = merged([found(SIZE), found(SIZE), found()])
    assert throughout(whole, 3, FILLED) == (f"in 2 of 3 frames: {SIZE}",)
    assert throughout(merged([found("lanes: no segmentation"), found()]), 2, FILLED) == ()


def test_of_many_kinds_of_messages_that_cannot_be_used_a_few_are_reported():
    texts = [SIZE.replace("image", role) for role in ("a", "b", "c", "d", "e", "f")]
    notes = throughout(merged([found(*texts), found()]), 2, FILLED)
    assert notes[:4] == tuple(f"in 1 of 2 frames: {text}" for text in texts[:4])
    assert notes[4:] == ("2 more kinds of messages that cannot be used, which roadperc-report lists",)


def test_a_missing_input_that_the_log_has_is_reported():
    assert throughout(found("lanes: no segmentation"), 1, FILLED) == ("in the only frame: lanes: no segmentation",)


def test_what_follows_from_another_reason_is_reported_once():
    why = "no plane fits three road points"
    later = (
        f"drivable: no surface: {why}",
        f"lanes: no surface: {why}",
        f"occupancy: no drivable surface: no surface: {why}",
    )
    assert throughout(found(f"surface: {why}", *later), 1, FILLED) == (f"in the only frame: surface: {why}",)


def test_of_many_a_few_are_reported():
    notes = throughout(found(*(f"lidar: {letter}" for letter in "abcdef")), 1, FILLED)
    assert [note.partition(": ")[2] for note in notes[:4]] == [f"lidar: {letter}" for letter in "abcd"]
    assert notes[4:] == ("in the only frame: 2 more reasons, which roadperc-report lists",)
    assert throughout(found(*(f"lidar: {letter}" for letter in "abcd")), 1, FILLED) == notes[:4]
    assert throughout(found(*(f"lidar: {letter}" for letter in "abcde")), 1, FILLED) == (
        *notes[:4],
        "in the only frame: 1 more reason, which roadperc-report lists",
    )


def test_the_command_prints_them(tmp_path, capsys):
    """The depth sensor's images are of another size than its camera's calibration says."""
    small = logs.items(3, road=logs.Road(width=64, height=48), roles=("depth",))
    source = logs.write(tmp_path / "in.mcap", [i for i in logs.items(3) if i.role != "depth"] + small)
    assert replay_main([str(source), str(tmp_path / "out.mcap")]) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: in all")]
    assert notes[0] == "note: in all 3 frames: depth: 64x48 pixels, its calibration says 320x240"
    assert not [note for note in notes if "right image" in note]


def test_the_command_prints_how_many_images_cannot_be_used(tmp_path, capsys):
    """The camera's images shrink on the way."""
    small, items = logs.items(3, road=logs.Road(width=64, height=48), roles=("image",)), logs.items(3)
    source = logs.write(tmp_path / "in.mcap", [small[-1] if i == items[-4] else i for i in items])
    assert items[-4].role == "image"
    assert replay_main([str(source), str(tmp_path / "out.mcap")]) == 0
    assert "note: in 1 of 3 frames: image: 64x48 pixels, its calibration says 320x240\n" in capsys.readouterr().out


def test_a_replay_that_lacks_nothing_prints_none(tmp_path, capsys):
    source = logs.write(tmp_path / "in.mcap", logs.items(2))
    assert replay_main([str(source), str(tmp_path / "out.mcap")]) == 0
    assert "frames:" not in capsys.readouterr().out
