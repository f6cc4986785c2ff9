"""Reasons of one kind are counted together, and a replay reports those that held in all frames."""

from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.model import Reason
from roadperc_stream.output.reason_counts import ReasonCount, grouped, merged, of_frame, ranked, throughout
from tests import logs

FILLED = ("image", "calibration", "segmentation")
TILTED = "surface: the points' plane is tilted by {} degrees, expected at most 30"
SIZE = "image: 520x360 pixels, its calibration says 640x480"


def found(*texts):
    """The reasons of one frame from a table."""
    return grouped(dict.fromkeys(texts, 1))


def test_texts_that_differ_in_numbers_are_one_kind():
    (count,) = grouped({TILTED.format(3): 1, TILTED.format(-12): 4}).values()
    assert count == ReasonCount(TILTED.format(-12), 5, varies=True)
    assert str(count) == f"{TILTED.format(-12)} (numbers vary)"
    (count,) = merged([found(SIZE), found(SIZE)]).values()
    assert (count, str(count)) == (ReasonCount(SIZE, 2), SIZE)


def test_a_varying_reason_stays_varying():
    first, second = found(TILTED.format(1)), found(TILTED.format(2))
    assert next(iter(merged([first, second, first]).values())) == ReasonCount(TILTED.format(1), 3, varies=True)
    assert merged([merged([first, second, first]), first]) == merged([first, merged([first, second, first])])


def test_reasons_read_back_from_text_are_equal():
    reasons = (Reason("image", "wrong_size", (520, 360, 640, 480)), Reason("surface", "plane_tilted", (90.0, 30.0)))
    assert of_frame(reasons) == found(SIZE, TILTED.format(90))


def test_frequent_reasons_come_first_and_inputs_before_stages():
    lanes, image, drivable = "lanes: no segmentation", SIZE, "drivable: neither depth nor segmentation"
    whole = merged([found(lanes, image, drivable), found(lanes)])
    assert [count.text for count in ranked(whole).values()] == [lanes, image, drivable]


def test_missing_topics_and_disabled_stages_are_not_reported():
    for text in (
        "stereo: no right image",
        "drivable: neither depth nor segmentation",
        "objects: no detections",
        "surface: no depth, the assumed height gives the plane",
        "lanes: no drivable surface: neither depth nor segmentation",
        "lanes: switched off",
        "lanes: no surface: switched off",
    ):
        assert throughout(found(text), 1, FILLED) == (), text


def test_only_reasons_of_all_frames_are_reported():
    late = "depth: no message at this frame"
    whole = merged([found(SIZE, late), found(SIZE)])
    assert throughout(whole, 2, FILLED) == (f"in all 2 frames: {SIZE}",)
    assert throughout(found(SIZE), 1, FILLED) == (f"in the only frame: {SIZE}",)


def test_unusable_messages_of_some_frames_are_reported():
    whole = merged([found(SIZE), found(SIZE), found()])
    assert throughout(whole, 3, FILLED) == (f"in 2 of 3 frames: {SIZE}",)
    assert throughout(merged([found("lanes: no segmentation"), found()]), 2, FILLED) == ()


def test_only_four_kinds_of_unusable_messages_are_listed():
    texts = [SIZE.replace("image", role) for role in ("a", "b", "c", "d", "e", "f")]
    notes = throughout(merged([found(*texts), found()]), 2, FILLED)
    assert notes[:4] == tuple(f"in 1 of 2 frames: {text}" for text in texts[:4])
    assert notes[4:] == ("2 more kinds of messages that cannot be used, which roadperc-report lists",)


def test_a_missing_input_with_a_topic_is_reported():
    assert throughout(found("lanes: no segmentation"), 1, FILLED) == ("in the only frame: lanes: no segmentation",)


def test_consequences_of_a_reason_are_not_reported():
    why = "no plane fits three road points"
    later = (
        f"drivable: no surface: {why}",
        f"lanes: no surface: {why}",
        f"occupancy: no drivable surface: no surface: {why}",
    )
    assert throughout(found(f"surface: {why}", *later), 1, FILLED) == (f"in the only frame: surface: {why}",)


def test_only_four_reasons_are_listed():
    notes = throughout(found(*(f"lidar: {letter}" for letter in "abcdef")), 1, FILLED)
    assert [note.partition(": ")[2] for note in notes[:4]] == [f"lidar: {letter}" for letter in "abcd"]
    assert notes[4:] == ("in the only frame: 2 more reasons, which roadperc-report lists",)
    assert throughout(found(*(f"lidar: {letter}" for letter in "abcd")), 1, FILLED) == notes[:4]
    (*_, last) = throughout(found(*(f"lidar: {letter}" for letter in "abcde")), 1, FILLED)
    assert last == "in the only frame: 1 more reason, which roadperc-report lists"


def test_the_command_prints_reasons_of_all_frames(tmp_path, capsys):
    """The size of the depth images differs from the calibration."""
    small = logs.items(3, road=logs.Road(width=64, height=48), roles=("depth",))
    source = logs.write(tmp_path / "in.mcap", [i for i in logs.items(3) if i.role != "depth"] + small)
    assert replay_main([str(source), str(tmp_path / "out.mcap")]) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: in all")]
    assert notes[0] == "note: in all 3 frames: depth: 64x48 pixels, its calibration says 320x240"
    assert not [note for note in notes if "right image" in note]


def test_the_command_prints_the_number_of_unusable_images(tmp_path, capsys):
    """The last image is smaller than the others."""
    small, items = logs.items(3, road=logs.Road(width=64, height=48), roles=("image",)), logs.items(3)
    source = logs.write(tmp_path / "in.mcap", [small[-1] if i == items[-4] else i for i in items])
    assert items[-4].role == "image"
    assert replay_main([str(source), str(tmp_path / "out.mcap")]) == 0
    assert "note: in 1 of 3 frames: image: 64x48 pixels, its calibration says 320x240\n" in capsys.readouterr().out


def test_a_replay_without_missing_inputs_prints_no_reasons(tmp_path, capsys):
    source = logs.write(tmp_path / "in.mcap", logs.items(2))
    assert replay_main([str(source), str(tmp_path / "out.mcap")]) == 0
    assert "frames:" not in capsys.readouterr().out
