"""Reasons of one kind are counted together, and a replay reports those that held in all frames."""

from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.model import Reason
from roadperc_stream.output.reason_counts import ReasonCount, grouped, merged, of_frame, ranked, throughout
from tests import logs

FILLED = ("image", "calibration", "segmentation")
SIZE = Reason("image", "wrong_size", (520, 360, 640, 480))
NO_TAGS = Reason("lanes", "no_segmentation")


def tilted(deg):
    return Reason("surface", "plane_tilted", (deg, 30.0))


def test_reasons_that_differ_in_numbers_are_one_kind():
    (count,) = grouped([(tilted(3.0), 1), (tilted(-12.0), 4)]).values()
    assert count == ReasonCount(tilted(-12.0), 5, varies=True)
    assert str(count) == f"{tilted(-12.0)} (numbers vary)"
    (count,) = merged([of_frame([SIZE]), of_frame([SIZE])]).values()
    assert (count, str(count)) == (ReasonCount(SIZE, 2), str(SIZE))


def test_a_varying_reason_stays_varying():
    first, second = of_frame([tilted(1.0)]), of_frame([tilted(2.0)])
    assert next(iter(merged([first, second, first]).values())) == ReasonCount(tilted(1.0), 3, varies=True)
    assert merged([merged([first, second, first]), first]) == merged([first, merged([first, second, first])])


def test_frequent_reasons_come_first_and_inputs_before_stages():
    drivable = Reason("drivable", "no_depth_no_segmentation")
    whole = merged([of_frame([NO_TAGS, SIZE, drivable]), of_frame([NO_TAGS])])
    assert [count.reason for count in ranked(whole).values()] == [NO_TAGS, SIZE, drivable]


def test_missing_topics_and_disabled_stages_are_not_reported():
    no_road = Reason("drivable", "no_depth_no_segmentation")
    for reason in (
        Reason("stereo", "no_right_image"),
        no_road,
        Reason("objects", "no_detections"),
        Reason("surface", "no_depth_plane_assumed", ("the assumed height",)),
        Reason("lanes", "no_drivable_surface", cause=no_road),
        Reason("lanes", "switched_off"),
        Reason("lanes", "no_surface", cause=Reason("surface", "switched_off")),
    ):
        assert throughout(of_frame([reason]), 1, FILLED) == (), reason


def test_only_reasons_of_all_frames_are_reported():
    whole = merged([of_frame([SIZE, Reason("depth", "no_message")]), of_frame([SIZE])])
    assert throughout(whole, 2, FILLED) == (f"in all 2 frames: {SIZE}",)
    assert throughout(of_frame([SIZE]), 1, FILLED) == (f"in the only frame: {SIZE}",)


def test_unusable_messages_of_some_frames_are_reported():
    whole = merged([of_frame([SIZE]), of_frame([SIZE]), {}])
    assert throughout(whole, 3, FILLED) == (f"in 2 of 3 frames: {SIZE}",)
    assert throughout(merged([of_frame([NO_TAGS]), {}]), 2, FILLED) == ()


def test_a_missing_input_with_a_topic_is_reported():
    assert throughout(of_frame([NO_TAGS]), 1, FILLED) == (f"in the only frame: {NO_TAGS}",)


def test_consequences_of_a_reason_are_not_reported():
    why = Reason("surface", "plane_without_points")
    drivable = Reason("drivable", "no_surface", cause=why)
    later = (
        drivable,
        Reason("lanes", "no_surface", cause=why),
        Reason("occupancy", "no_drivable_surface", cause=drivable),
    )
    assert throughout(of_frame([why, *later]), 1, FILLED) == (f"in the only frame: {why}",)


def test_only_six_reasons_are_listed():
    notes = throughout(of_frame(Reason("lidar", "other", (letter,)) for letter in "abcdefgh"), 1, FILLED)
    assert [note.partition(": ")[2] for note in notes[:6]] == [f"lidar: {letter}" for letter in "abcdef"]
    assert notes[6:] == ("2 more reasons, which roadperc-report lists",)


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
