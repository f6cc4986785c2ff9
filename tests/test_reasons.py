"""Reasons that differ in numbers alone are one, and a replay tells of those that held in all frames."""

from collections import Counter

import pytest

from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.reasons import Reason, grouped, merged, ranked, throughout
from tests import logs

FILLED = ("image", "calibration", "segmentation")


def found(*texts):
    """What one frame's reasons are among several frames."""
    return grouped(Counter(texts))


def test_texts_that_differ_in_numbers_are_one_reason_and_the_commonest_stands_for_it():
    (reason,) = grouped({"tilted by 3 degrees": 1, "tilted by -12.5 degrees": 4}).values()
    assert reason == Reason("tilted by -12.5 degrees", 5, varies=True)
    assert str(reason) == "tilted by -12.5 degrees (numbers vary)"


def test_the_same_text_twice_does_not_vary():
    (reason,) = merged([found("image: 520x360 pixels"), found("image: 520x360 pixels")]).values()
    assert reason == Reason("image: 520x360 pixels", 2)
    assert str(reason) == "image: 520x360 pixels"


def test_a_reason_varies_for_good():
    parts = [found("at 1"), found("at 2"), found("at 1")]
    assert next(iter(merged(parts).values())) == Reason("at 1", 3, varies=True)
    assert merged([merged(parts), found("at 1")]) == merged([found("at 1"), merged(parts)])


def test_the_most_frequent_come_first_and_inputs_before_stages():
    whole = merged([found("lanes: a", "image: b", "drivable: c"), found("lanes: a")])
    assert [reason.text for reason in ranked(whole).values()] == ["lanes: a", "image: b", "drivable: c"]


@pytest.mark.parametrize(
    "text",
    [
        "stereo: no right image",
        "drivable: neither depth nor segmentation",
        "objects: no detections",
        "surface: no depth, the assumed height gives the plane",
        "lanes: switched off",
        "lanes: no surface: switched off",
    ],
)
def test_what_the_log_lacks_or_the_user_switched_off_is_not_told(text):
    assert throughout(found(text), 1, FILLED) == ()


def test_what_held_in_all_frames_is_told_and_nothing_else():
    size, late = "image: 520x360 pixels, its calibration says 640x480", "depth: no message at this frame"
    whole = merged([found(size, late), found(size)])
    assert throughout(whole, 2, FILLED) == (f"in all 2 frames: {size}",)
    assert throughout(found(size), 1, FILLED) == (f"in the only frame: {size}",)


def test_a_lack_of_an_input_that_the_log_has_is_told():
    assert throughout(found("lanes: no segmentation"), 1, FILLED) == ("in the only frame: lanes: no segmentation",)


def test_what_follows_from_another_reason_is_told_once():
    why = "no plane holds three of the road's points"
    whole = found(f"surface: {why}", f"lanes: no surface: {why}", f"drivable: no surface: {why}")
    assert throughout(whole, 1, FILLED) == (f"in the only frame: surface: {why}",)


def test_of_many_a_few_are_told():
    told = throughout(found(*(f"lidar: {letter}" for letter in "abcdef")), 1, FILLED)
    assert [note.partition(": ")[2] for note in told[:4]] == [f"lidar: {letter}" for letter in "abcd"]
    assert told[4:] == ("in the only frame: 2 more reasons, which roadperc-report lists",)
    assert throughout(found(*(f"lidar: {letter}" for letter in "abcd")), 1, FILLED) == told[:4]
    assert throughout(found(*(f"lidar: {letter}" for letter in "abcde")), 1, FILLED) == (
        *told[:4],
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


def test_a_replay_that_lacks_nothing_prints_none(tmp_path, capsys):
    source = logs.write(tmp_path / "in.mcap", logs.items(2))
    assert replay_main([str(source), str(tmp_path / "out.mcap")]) == 0
    assert "frames:" not in capsys.readouterr().out
