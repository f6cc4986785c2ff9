"""Wrong usage of the commands, and their help."""

import pytest

from roadperc_stream.cli import compare, lanes, report, trajectory
from tests.eval.tables import usage_error

WRONG = [
    *((report, arguments) for arguments in ([], ["x", "--worst", "0"], ["x", "--worst", "many"])),
    *((compare, arguments) for arguments in ([], ["a"], ["a", "b", "--allow", "5"], ["a", "b", "--tolerance", "x"])),
    *((lanes, ["a.mcap", *arguments]) for arguments in ([], ["--truth", "a.json", "--size", "0x5"])),
    *((trajectory, ["x", "--delta", delta]) for delta in ("0", "1.5", "nan", "inf")),
    *((trajectory, arguments) for arguments in ([], ["x", "--align", "se2"], ["x", "--delta-unit", "s"])),
]
EXAMPLES = {
    report: ["roadperc-report runs/"],
    compare: ["roadperc-compare base.mcap other.mcap", "0  no metric is worse"],
    trajectory: ["example:", "of the ego frame"],
}


@pytest.mark.parametrize(("command", "arguments"), WRONG)
def test_wrong_usage_exits_2(command, arguments, capsys):
    assert f"roadperc-{command.__name__.rpartition('.')[2]}: error:" in usage_error(command.main, capsys, *arguments)


@pytest.mark.parametrize("command", EXAMPLES)
def test_help_has_an_example(command, capsys):
    with pytest.raises(SystemExit) as end:
        command.main(["--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert [example for example in EXAMPLES[command] if example not in text] == []
