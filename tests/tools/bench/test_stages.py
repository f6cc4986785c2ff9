"""The benchmark measures and prints; it is never a test of time itself."""

from roadperc_stream.tools.bench import stages
from tests import logs


def test_every_stage_beside_the_decode_of_an_image(tmp_path, capsys):
    path = logs.write(tmp_path / "in.mcap", logs.items())
    assert stages.main([str(path), "--frames", "2"]) == 0
    out = capsys.readouterr().out
    for name in ("decode", "surface", "lanes", "objects", "camera image"):
        assert name in out


def test_a_log_without_images_says_so(tmp_path, capsys):
    path = logs.write(tmp_path / "in.mcap", logs.items(roles=("calibration", "depth")))
    assert stages.main([str(path)]) == 1
    assert "no camera image" in capsys.readouterr().err
