"""What of the renderer's options does not go together, or is out of its range."""

import pytest

from roadperc_stream.cli.render import main


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--change-back",), "--change-lane"),
        (("--change-lane", "left", "--change-back", "--change-broken-off"), "broken off"),
        (("--lead-brakes", "--stop-and-go"), "--stop-and-go"),
        (("--static", "--turn"), "--static"),
        (("--turn", "--change-lane", "left"), "--change-lane"),
        (("--lane", "ends", "--crossing-cars"), "--lane"),
        (("--bumps", "--scene", "bend"), "--bumps"),
        (("--fov", "150"), "--fov"),
        (("--fov", "120", "--scene", "town"), "not level"),
        (("--mount", "9,0,1,0,0,0"), "--mount x"),
        (("--worn-lines", "30,20"), "--worn-lines"),
        (("--pitch-std", "-1"), "--pitch-std"),
    ],
)
def test_what_does_not_go_together_is_refused(tmp_path, capsys, options, text):
    assert main([str(tmp_path / "dump"), *options]) == 1
    assert text in capsys.readouterr().err
    assert not (tmp_path / "dump").exists()


@pytest.mark.parametrize("options", [("--mount", "1,2,3"), ("--missing-lines", "a,b"), ("--turn", "back")])
def test_what_is_no_number_is_wrong_usage(tmp_path, options):
    with pytest.raises(SystemExit) as error:
        main([str(tmp_path / "dump"), *options])
    assert error.value.code == 2


def test_a_camera_that_sees_no_sky(tmp_path):
    """It looks so far down that its whole view is below the horizon."""
    mount = ("--mount", "1.5,0,1.4,0,-40,0", "--fov", "60")
    options = ("--scene", "straight", "--size", "64x48", "--seconds", "0.5", "--rate", "2", *mount)
    assert main([str(tmp_path / "dump"), *options]) == 0
