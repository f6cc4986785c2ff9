"""Ranking of settings on hand-made datasets with known answers."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.cli.sweep import varied
from roadperc_stream.config import load_config
from roadperc_stream.errors import TableError
from roadperc_stream.eval.sweep.combinations import combinations, reference_of
from roadperc_stream.eval.sweep.ranking import METRICS, SettingScore, best, effect, scores
from roadperc_stream.eval.sweep.sweep import best_settings, effects, without_effect
from roadperc_stream.output.tables import TableWriter
from roadperc_stream.schemas.columns import EXTRA_COLUMNS, FrameMetrics
from tests.eval.tables import row

ERROR = next(metric for metric in METRICS if metric.quantity.column == "lane_left_error_m")
OVERLAP = next(metric for metric in METRICS if metric.quantity.column == "drivable_iou")
JITTER = next(metric for metric in METRICS if metric.quantity.name == "lane left jitter")
MEASURED = next(metric for metric in METRICS if metric.quantity.name == "lane left measured")
TRACKED = next(metric for metric in METRICS if metric.quantity.name == "odometry tracked")
TIME = next(metric for metric in METRICS if metric.quantity.column == "total_ms")


def made(*options):
    return combinations(None, (), dict(varied(option) for option in options))


GATES = made("lanes.gate=1,2,3")


def dataset(folder, columns, count=2):
    """One table per combination and log: each log has the rows, a list of columns each, of its combination."""
    for item, rows in zip(GATES, columns, strict=True):
        for name in range(count):
            path = folder / item.folder / f"{name}.metrics.parquet"
            with TableWriter(path, FrameMetrics, {}, EXTRA_COLUMNS, item.settings) as table:
                for frame, values in enumerate(rows):
                    table.append(row(frame, **values), total_ms=10.0)
    return sorted(folder.rglob("*.parquet"))


def errors(*values):
    return [{"lane_left_error_m": value} for value in values]


def test_scores_are_medians_of_the_absolute_error_with_coverage(tmp_path):
    files = dataset(tmp_path, [errors(0.1, -0.3, 0.2), errors(-0.4, None, 0.0), errors(None, None, None)])
    found = scores(files, GATES, ERROR)
    assert found == [SettingScore(0.2, 1.0), SettingScore(0.2, pytest.approx(2 / 3)), SettingScore(None, 0.0)]


def test_the_score_of_a_share_is_its_mean(tmp_path):
    rows = [[{"drivable_iou": share} for share in shares] for shares in ((1.0, 1.0, 0.4), (1.0, 1.0, 1.0), (0.9,))]
    assert [score.value for score in scores(dataset(tmp_path, rows), GATES, OVERLAP)] == pytest.approx([0.8, 1.0, 0.9])


def test_a_table_that_cannot_be_read_is_an_error(tmp_path):
    files = dataset(tmp_path, [errors(0.1)] * 3)
    files[0].write_bytes(b"no table")
    with pytest.raises(TableError, match="cannot be read"):
        scores(files, GATES, ERROR)


def test_jitter_does_not_cross_logs_or_lane_changes(tmp_path):
    """The second differences of a parabola are equal, with deviation 0; those of a kink are 0 and 1."""
    rows = [
        [
            {"lane_left_offset_m": offset, "lane_left_raw_offset_m": offset, "lane_changes": int(k > 3)}
            for k, offset in at
        ]
        for at in map(enumerate, ((0, 1, 4, 9, 40), (0, 0, 0, 1, 7), (5, 5, 5, 5, 8)))
    ]
    files = dataset(tmp_path, rows)
    assert scores(files, GATES, JITTER) == [SettingScore(0.0, 0.4), SettingScore(0.5, 0.4), SettingScore(0.0, 0.4)]


def test_measured_and_tracked_are_shares_of_the_status(tmp_path):
    """A held boundary may have a raw offset, and a tracked frame no scale."""
    statuses = ("measured", "held", "lost", None)
    rows = [
        {"lane_left_status": status, "lane_left_raw_offset_m": 1.0, "odometry_status": "tracked"} for status in statuses
    ]
    files = dataset(tmp_path, [rows] * 3)
    assert scores(files, GATES, MEASURED) == [SettingScore(0.25, 1.0)] * 3
    assert scores(files, GATES, TRACKED) == [SettingScore(1.0, 1.0)] * 3


@pytest.mark.parametrize(
    ("metric", "found", "expected"),
    [
        (ERROR, [(0.2, 1.0), (0.1, 1.0), (0.1004, 1.0)], (2, None)),  # equal scores: the reference, the last one
        (ERROR, [(0.1, 1.0), (0.1, 1.0), (0.2, 1.0)], (0, None)),  # else the first
        (ERROR, [(0.3, 1.0), (0.1, 0.5), (0.2, 0.995)], (2, 1)),  # a better score at lower coverage comes second
        (ERROR, [(0.3, 0.5), (0.1, 0.5), (0.2, 0.0)], (1, None)),
        (ERROR, [(0.1, 0.9), (0.3, 1.0), (None, 0.0)], (1, 0)),
        (TIME, [(29.0, 1.0), (28.0, 1.0), (30.0, 1.0)], (2, None)),  # times within their noise are equal
        (TIME, [(30.0, 1.0), (20.0, 1.0), (29.0, 1.0)], (1, None)),
        (ERROR, [(None, 0.0)] * 3, None),
    ],
)
def test_the_best_setting(metric, found, expected):
    assert best(metric, [SettingScore(*score) for score in found], GATES, GATES[2]) == expected


def test_of_equal_settings_the_one_with_the_fewest_changes_is_best():
    some = made("lanes.gate=1,2", "lanes.hold_s=1,2")
    found = [SettingScore(0.2, 1.0), SettingScore(0.1, 1.0), SettingScore(0.2, 1.0), SettingScore(0.1, 1.0)]
    assert best(ERROR, found, some, some[2]) == (3, None)


def test_the_reference_is_the_configured_setting_or_the_first():
    assert reference_of(made("lanes.hold_s=2,0.5"), load_config()).number == 1
    assert reference_of(GATES, load_config()).number == 0


@given(
    st.lists(st.tuples(st.none() | st.floats(-1e3, 1e3), st.floats(0, 1)), min_size=3, max_size=3),
    st.integers(0, 2),
)
def test_no_setting_with_the_same_coverage_is_better_than_the_best(pairs, reference):
    found = [SettingScore(value, coverage if value is not None else 0.0) for value, coverage in pairs]
    for metric in (ERROR, OVERLAP):
        chosen = best(metric, found, GATES, GATES[reference])
        known = [score for score in found if score.value is not None]
        assert (chosen is None) == (not known)
        if chosen is not None:
            winner = found[chosen[0]]
            rivals = [score for score in known if score.coverage >= winner.coverage]
            assert metric.badness(winner.value) <= min(metric.badness(s.value) for s in rivals) + 0.001


def test_effects_are_means_over_the_other_settings():
    some = made("lanes.gate=1,2", "lanes.hold_s=1,2")
    found = [SettingScore(0.1, 1.0), SettingScore(0.3, 0.5), SettingScore(None, 0.0), SettingScore(0.6, 1.0)]
    assert effect(found, some, "lanes.gate") == {
        1.0: SettingScore(pytest.approx(0.2), 0.75),
        2.0: SettingScore(0.6, 0.5),
    }
    assert effect(found, some, "lanes.hold_s") == {
        1.0: SettingScore(0.1, 0.5),
        2.0: SettingScore(pytest.approx(0.45), 0.75),
    }


def cells(table):
    """The columns of a table, the labels first."""
    return [list(column) for column in zip(*table.rows, strict=True)]


def test_the_table_shows_the_best_setting_the_reference_and_lower_coverage():
    found = [
        (ERROR, [SettingScore(0.3, 1.0), SettingScore(0.1, 0.5), SettingScore(0.2, 1.0)]),
        (OVERLAP, [SettingScore(0.9, 1.0)] * 3),
    ]
    assert cells(best_settings(found, GATES, GATES[0])) == [
        ["lane left error at 10 m, m", "  lower coverage"],
        ["0.200", "0.100"],
        ["100.0", "50.0"],
        ["0.300", "0.300"],
        ["100.0", "100.0"],
        ["gate=3", "gate=2"],
    ]
    assert without_effect(found) == "no difference: drivable IoU"
    assert cells(effects(found, GATES, "lanes.gate"))[0] == ["lane left error at 10 m, m", "  frames %"]
    assert cells(effects(found, GATES, "lanes.gate"))[2] == ["0.100", "50.0"]
