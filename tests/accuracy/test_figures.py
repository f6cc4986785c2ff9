"""The list of figures, their bounds, and their display."""

import polars as pl
import pytest

from tests.accuracy import of_motion, of_objects, of_uncertainty
from tests.accuracy.__main__ import cells, summary, with_figures, with_sections
from tests.accuracy.drives import Drive, drive
from tests.accuracy.figures import FIGURES, Figure
from tests.accuracy.running import Replayed, Results, seeds_of
from tests.accuracy.scenarios import BY_MODEL
from tests.accuracy.values import Measured, Value, at_least, at_most, judged, nothing
from tests.eval.tables import row, write

NONE = Results({}, {})


def frames(**columns):
    return [Replayed("drive", 0, None, pl.DataFrame(columns), None)]


def test_every_figure_says_why_it_is_not_measured():
    for figure in FIGURES:
        found = figure.measured(NONE)
        assert found.met is None, figure.name
        assert "not measured" in found.text or "absent" in found.text


def test_figures_scenarios_and_drives_have_unique_names():
    names = [(figure.section, figure.name) for figure in FIGURES]
    assert len(set(names)) == len(names)
    scenarios = {scenario for figure in FIGURES for scenario in figure.scenarios}
    assert len({scenario.name for scenario in scenarios}) == len(scenarios)
    drives = {scenario.source for scenario in scenarios if isinstance(scenario.source, Drive)}
    assert len({of.name for of in drives}) == len(drives)


def test_the_renderer_takes_every_drive():
    for scenario in {scenario for figure in FIGURES for scenario in figure.scenarios}:
        if isinstance(scenario.source, Drive):
            scenario.source.options.check()


@pytest.mark.parametrize(
    ("bound", "number", "expected"),
    [
        (at_most(1, "%"), 1.0, ("≤ 1 %", "1.0 %", True)),
        (at_most(1, "%"), 1.01, ("≤ 1 %", "1.0 %", False)),
        (at_least(0.995, ""), 0.994, ("≥ 0.995", "0.9940", False)),
        (at_most(None, "cm"), 3.0, ("", "3.00 cm", None)),
        (None, 3.0, (None, "3.0 %", None)),
        (at_most(1, "%"), None, ("≤ 1 %", "not measured: no such frame", None)),
    ],
)
def test_a_value_is_judged_by_its_bound(bound, number, expected):
    found = judged(bound, Value(number, 0.5))
    assert (bound and bound.text, found.text, found.met) == expected
    assert found.coverage == ("" if number is None else "50.0 %")


def test_the_number_of_seeds_depends_on_the_drive():
    assert list(seeds_of(drive("a", 2.5, scene="town"), 100, 2)) == [100, 101, 102, 103, 104]
    assert list(seeds_of(drive("a", 0.1, scene="town"), 100, 2)) == [100]
    assert list(seeds_of("logs/sample.mcap", 100, 8)) == [100]


def test_steps_without_scale_reduce_the_coverage():
    replays = frames(step_m=[None, 1.1, None, 0.9], true_step_m=[None, 1.0, 1.0, 1.0])
    assert of_motion.step_error(replays).number == pytest.approx(10.0)
    assert of_motion.length_error(replays).number == pytest.approx(0.0, abs=1e-9)
    assert of_motion.with_scale(replays).number == pytest.approx(200 / 3)


@pytest.mark.parametrize(("auto", "met"), [(0.022, True), (0.023, False), (None, None)])
def test_the_chosen_model_is_compared_with_the_better_one(auto, met):
    found = {"plane": 0.1, "spline": 0.02, "auto": auto}
    replays = {
        BY_MODEL["hill", model][0].name: frames(surface_height_error_m=[error, -error])
        for model, error in found.items()
        if error
    }
    measured = of_motion.by_model("hill", "surface_height_error_m", Results(replays, {}))
    assert measured.met is met
    assert measured.text.startswith("10.00 / 2.00 / ")


def test_precision_and_recall_use_sums_over_frames():
    replays = frames(filter_tp=[8, 1], filter_fp=[1, 0], filter_fn=[0, 1])
    assert of_objects.precision(replays).number == 0.9
    assert of_objects.recall(replays).number == 0.9


def test_impact_errors_count_frames_with_an_estimate():
    true_s = [1.0, 1.0, 2.0, 9.0]
    replays = frames(frame=[0, 1, 2, 3], time_to_impact_s=[1.1, None, 2.6, 9.0], true_time_to_impact_s=true_s)
    assert of_objects.impact_known(replays).number == pytest.approx(200 / 3)
    assert of_objects.impact_known(replays, first=2).number == 100.0
    assert of_objects.impact_error(replays).number == pytest.approx(0.35)
    assert of_objects.impact_error(replays, 0.95).coverage == pytest.approx(2 / 3)


def test_uncertainty_equals_that_of_the_report(tmp_path):
    path = write(tmp_path / "drive.metrics.parquet", [row(k, step_m=1.0 + k, true_step_m=1.0) for k in range(4)])
    pl.read_parquet(path).with_columns(step_std_m=pl.Series([1.0] * 4)).write_parquet(path)
    scenario = BY_MODEL["hill", "plane"][0]
    results = Results({scenario.name: [Replayed(scenario.name, 0, path, None, None)]}, {})
    assert of_uncertainty.shares("step", (scenario,), 2, results) == Measured(
        "50.0 / 75.0 / 0.0 % (NEES 3.5)", "100.0 %", False
    )
    assert of_uncertainty.shares("turn", (scenario,), 2, results) == nothing("no truth")


def test_the_tables_of_the_page_are_replaced():
    figures = [Figure("One", "a", "≤ 1 %", (), None), Figure("Two", "b", "", (), None)]
    lines = [(figures[0], Measured("2.0 %", "50.0 %", False)), (figures[1], Measured("3.0 %", "", None))]
    assert cells(*lines[0]) == ("a", "≤ 1 %", "2.0 %", "50.0 %", "no")
    assert summary(lines) == "0 of 1 required figures are met, 0 could not be measured"
    page = "Before\n<!-- figures -->\nold\n<!-- end -->\nbehind\n"
    once = with_figures(page, lines, "Seeds.")
    assert "| a | ≤ 1 % | 2.0 % | 50.0 % | no |" in once
    assert "old" not in once
    assert with_figures(once, lines, "Seeds.") == once
    with pytest.raises(ValueError, match="figures"):
        with_figures("nothing", lines, "Seeds.")


def test_the_tables_of_some_sections_are_replaced():
    def about_one(figures):
        return f"About {figures[0].name}."

    figures = [Figure(section, "a", "", (), None) for section in ("One", "Two")]
    lines = [(figure, Measured("1.0 %", "", None)) for figure in figures]
    page = with_figures("<!-- figures -->\n<!-- end -->\n", lines, "All.")
    newer = with_sections(page, [(figures[0], Measured("2.0 %", "", None))], about_one)
    assert "### One\n\nAbout a.\n\n| figure |" in newer
    assert newer.index("2.0 %") < newer.index("### Two") < newer.index("1.0 %")
    assert with_sections(newer, [(figures[0], Measured("2.0 %", "", None))], about_one) == newer
    added = with_sections(newer, [(Figure("Three", "b", "", (), None), Measured("3.0 %", "", None))], about_one)
    assert added.index("1.0 %") < added.index("### Three") < added.index("3.0 %") < added.index("<!-- end -->")
    with pytest.raises(ValueError, match="end"):
        with_sections("nothing", lines, about_one)
