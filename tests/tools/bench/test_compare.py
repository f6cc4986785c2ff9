"""Comparison of two versions: intervals of ratios, output and exit code for known series."""

import json
from contextlib import nullcontext

import numpy as np
import pytest

from roadperc_stream.errors import ProgramError
from roadperc_stream.tools.bench import compare
from roadperc_stream.tools.bench.compare import Ratio, compared, ratio_of, signed_rank_probabilities
from roadperc_stream.tools.bench.inputs import BenchLog
from roadperc_stream.tools.bench.replays import installed

ROUNDS = 10
NOISY = [10.0, 30.0, 11.0, 25.0, 9.0, 14.0, 60.0, 10.0]


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


def test_equal_series_and_small_parts_have_no_verdict():
    found = verdicts(series())
    assert (found["stereo"], set(found.values())) == (None, {"no difference shown", None})


def test_verdicts_of_the_whole_interval():
    found = verdicts(series(lanes=8.0, cpu=102.0))
    assert (found["lanes"], found["cpu"]) == ("faster", "no difference shown")
    verdict = [
        Ratio(1.1, low, high).verdict(0.03) for low, high in ((1.04, 1.2), (1.02, 1.2), (0.9, 1.01), (0.8, 0.99))
    ]
    assert verdict == ["slower", "no difference shown", "no difference shown", "faster"]


def test_a_part_of_only_one_version_is_listed():
    rows = {row.name: row for row in compared(series(**{"part/copy": 5.0}), "png", 0.03, 0.99)}
    assert (rows["copy"].base, rows["copy"].ratio, rows["copy"].verdict) == (None, None, None)
    assert rows["copy"].new == pytest.approx(5.0, rel=0.01)


@pytest.mark.parametrize(("lanes", "code"), [(11.0, 1), (9.0, 0)])
def test_the_command_prints_and_writes_the_verdicts(tmp_path, monkeypatch, capsys, lanes, code):
    logs = {name: BenchLog(name, tmp_path, tmp_path, tmp_path, 4) for name in ("png", "stereo")}
    monkeypatch.setattr(compare, "logs_of", lambda _: logs)
    monkeypatch.setattr(compare, "installed", nullcontext)
    monkeypatch.setattr(compare, "measured", lambda *_: series(lanes))
    out = tmp_path / "compared.json"
    assert compare.main([str(tmp_path), "main", "--logs", "png", "--json", str(out)]) == code
    printed = capsys.readouterr()
    assert ("slower" in printed.out) == bool(code)
    assert ("slower than main by more than 3%: png: lanes" in printed.err) == bool(code)
    row = next(row for row in json.loads(out.read_text()) if row["name"] == "lanes")
    assert row["ratio"]["middle"] == pytest.approx(lanes / 10, rel=0.01)
    assert row["verdict"] == ("slower" if code else "faster")


def test_an_unknown_commit_is_an_error():
    with pytest.raises(ProgramError, match="no-such-commit"), installed("no-such-commit"):
        pass


@pytest.mark.parametrize("count", [1, 6, 12])
def test_probabilities_are_those_of_wilcoxons_test(count):
    from scipy.stats import wilcoxon  # takes a second in each process that collects the tests

    rng = np.random.default_rng(count)
    values = rng.normal(0.4, 1, count)
    ranks = np.argsort(np.argsort(np.abs(values))) + 1
    below = signed_rank_probabilities(count)[: int(ranks[values < 0].sum()) + 1].sum()
    assert wilcoxon(values, alternative="greater", method="exact").pvalue == pytest.approx(below)


@pytest.mark.parametrize(
    ("base", "new", "expected"),
    [
        ([1.0] * 6, [1.0, 1.1, 1.2, 1.3, 1.4, 1.5], (1.0, 1.241, 1.5)),
        ([1.0] * 5, [1.1] * 5, (0.0, 1.1, np.inf)),
        (NOISY, [1.2 * value for value in NOISY], (1.2, 1.2, 1.2)),
    ],
    ids=["P(sum of ranks = 0) is 1/64 on either side", "five rounds cannot", "noise of both"],
)
def test_intervals_of_95_percent(base, new, expected):
    ratio = ratio_of(base, new, 0.95)
    assert (ratio.low, ratio.middle, ratio.high) == pytest.approx(expected, rel=0.005)


def test_the_interval_has_the_stated_confidence():
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(1000):
        base, new = np.exp(0.05 * rng.standard_t(2, (2, 8)))
        ratio = ratio_of(base.tolist(), (1.1 * new).tolist(), 0.95)
        held += ratio.low <= 1.1 <= ratio.high
    assert 930 <= held <= 980


def test_unknown_logs_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        compare.main([str(tmp_path), "main", "--logs", "png,gif"])
    assert end.value.code == 2
    assert "expected some of png,jpeg,stereo,truth" in capsys.readouterr().err
