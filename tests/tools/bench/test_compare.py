"""Two versions in turn: what is said of known series, and with which exit code."""

import json
from contextlib import nullcontext

import pytest

from roadperc_stream.errors import ProgramError, RegressionError
from roadperc_stream.tools.bench import compare
from roadperc_stream.tools.bench.compare import compared, require_no_slower
from roadperc_stream.tools.bench.replays import installed

ROUNDS = 10


def scattered(value):
    return [value * (1 + 0.002 * (k % 3)) for k in range(ROUNDS)]


def series(lanes=10.0, cpu=100.0, **more):
    found = {"control": [100.0] * ROUNDS}
    for version, factor in (("base", None), ("new", 1)):
        values = {"cpu": 100.0, "wall": 100.0, "peak_mb": 300.0, "first frame/cpu": 900.0, "part/lanes": 10.0}
        values |= {"part/decode": 20.0, "part/stereo": 0.02}
        if factor:
            values |= {"cpu": cpu, "part/lanes": lanes, "part/stereo": 0.2} | more
        found |= {f"{version} png/{name}": scattered(value) for name, value in values.items()}
    return found


def verdicts(found):
    return {row.name: row.verdict for row in compared(found, "png", 0.03, 0.99)}


def test_nothing_changed():
    assert set(verdicts(series()).values()) == {"no difference shown", None}
    require_no_slower(compared(series(), "png", 0.03, 0.99), "main", 0.03)


def test_a_part_that_is_slower_is_named():
    rows = compared(series(lanes=11.0), "png", 0.03, 0.99)
    assert {row.name for row in rows if row.verdict == "slower"} == {"lanes"}
    with pytest.raises(RegressionError, match="surely slower than main by more than 3%: png: lanes"):
        require_no_slower(rows, "main", 0.03)


def test_what_is_faster_or_slower_by_little_is_no_regression():
    found = verdicts(series(lanes=8.0, cpu=102.0))
    assert (found["lanes"], found["cpu"]) == ("faster", "no difference shown")


def test_a_part_of_nothing_has_no_verdict():
    assert verdicts(series())["stereo"] is None


def test_a_part_that_only_one_of_them_has_is_listed():
    rows = {row.name: row for row in compared(series(**{"part/copy": 5.0}), "png", 0.03, 0.99)}
    assert (rows["copy"].base, rows["copy"].ratio, rows["copy"].verdict) == (None, None, None)
    assert rows["copy"].new == pytest.approx(5.0, rel=0.01)


@pytest.mark.parametrize(("lanes", "code"), [(11.0, 1), (9.0, 0)])
def test_the_command_prints_writes_and_ends_with_the_verdict(bench_logs, tmp_path, monkeypatch, capsys, lanes, code):
    monkeypatch.setattr(compare, "logs_of", lambda _: bench_logs)
    monkeypatch.setattr(compare, "installed", nullcontext)
    monkeypatch.setattr(compare, "measured", lambda *_: series(lanes))
    out = tmp_path / "compared.json"
    assert compare.main([str(tmp_path), "main", "--logs", "png", "--json", str(out)]) == code
    printed = capsys.readouterr()
    assert ("slower" in printed.out) == bool(code)
    assert ("surely slower than main by more than 3%: png: lanes" in printed.err) == bool(code)
    row = next(row for row in json.loads(out.read_text()) if row["name"] == "lanes")
    assert row["ratio"]["middle"] == pytest.approx(lanes / 10, rel=0.01)
    assert row["verdict"] == ("slower" if code else "faster")


def test_both_versions_of_a_log_follow_each_other(bench_logs, tmp_path):
    jobs = compare._jobs(tmp_path, [bench_logs["png"], bench_logs["stereo"]], tmp_path / "base", 1)
    assert list(jobs) == ["base png", "new png", "base stereo", "new stereo"]


def test_no_such_commit():
    with pytest.raises(ProgramError, match="no-such-commit"), installed("no-such-commit"):
        pass


def test_unknown_logs_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        compare.main([str(tmp_path), "main", "--logs", "png,gif"])
    assert end.value.code == 2
    assert "expected some of png,jpeg,stereo,truth" in capsys.readouterr().err
