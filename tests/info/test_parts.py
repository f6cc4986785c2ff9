"""What roadperc-info says of how several logs join as the parts of one."""

from roadperc_stream.cli.info import main
from tests import logs
from tests.logs import START_NS, STEP_NS


def test_info_says_how_parts_join(tmp_path, capsys):
    items = logs.items(12)

    def part(name, first, last):
        kept = [item for item in items if first <= (item.stamp_ns - START_NS) // STEP_NS <= last]
        return str(logs.write(tmp_path / name, kept))

    files = [part("c.mcap", 7, 11), part("a.mcap", 0, 4), part("b.mcap", 3, 5)]
    assert main(files) == 0
    text = capsys.readouterr().out.partition("As the parts of one log")[2]
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


def test_json_and_a_single_log_say_nothing_of_parts(tmp_path, capsys):
    path = str(logs.write(tmp_path / "a.mcap", logs.items(2)))
    assert main([path]) == 0
    assert main(["--json", path, path]) == 0
    assert "parts of one" not in capsys.readouterr().out
