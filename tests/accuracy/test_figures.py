"""The figures: every one can be measured and judged, and the tables of the page are replaced."""

from dataclasses import replace

import pytest

from tests.accuracy.__main__ import summary
from tests.accuracy.bounds import Measured, Value, at_least, at_most
from tests.accuracy.drives import Drive, Noise, drive
from tests.accuracy.figures import FIGURES, Figure
from tests.accuracy.page import tables, with_tables
from tests.accuracy.running import Results, replay_source, run, seeds_of
from tests.accuracy.scenarios import Scenario


def test_figures_scenarios_and_drives_have_unique_names_and_valid_options():
    names = [(figure.section, figure.name) for figure in FIGURES]
    assert len(set(names)) == len(names)
    scenarios = {scenario for figure in FIGURES for scenario in figure.scenarios}
    assert len({scenario.name for scenario in scenarios}) == len(scenarios)
    drives = {scenario.source for scenario in scenarios if isinstance(scenario.source, Drive)}
    assert len({of.name for of in drives}) == len(drives)
    for of in drives:
        of.options.check()


def test_every_figure_says_why_it_is_not_measured():
    assert {figure.measured(Results({}, {})) for figure in FIGURES} == {Measured("not measured: not run", "", None)}


@pytest.mark.parametrize(
    ("bound", "number", "expected"),
    [
        (at_most(1), 1.0, ("≤ 1 %", "1.0 %", True)),
        (at_most(1), 1.01, ("≤ 1 %", "1.0 %", False)),
        (at_least(0.995, ""), 0.994, ("≥ 0.995", "0.9940", False)),
        (at_most(None, "cm"), 3.0, ("", "3.00 cm", None)),
        (at_most(1), None, ("≤ 1 %", "not measured: no such frame", None)),
    ],
)
def test_a_value_is_judged_by_its_bound(bound, number, expected):
    found = bound.judge(Value(number, 0.5))
    assert (bound.text, found.text, found.met) == expected
    assert found.coverage == ("" if number is None else "50.0 %")


def test_the_number_of_seeds_depends_on_the_drive():
    assert list(seeds_of(drive("a", 2.5, scene="town"), 100, 2)) == [100, 101, 102, 103, 104]
    assert list(seeds_of(drive("a", 0.1, scene="town"), 100, 2)) == [100]
    assert list(seeds_of("logs/sample.mcap", 100, 8)) == [100]


def line(section, text, met=None, name="a", limit=1):
    return Figure(section, name, at_most(limit), (), None), Measured(text, "50.0 %", met)


def test_the_tables_of_the_page_are_replaced():
    page = "Before\n<!-- figures -->\nold\n<!-- end -->\nbehind\n"
    lines = [line("One", "2.0 %", met=False), line("Two", "3.0 %")]
    assert summary(lines) == "0 of 2 required figures are met, 1 could not be measured"
    all_new = with_tables(page, lines, "Seeds.", whole=True)
    assert "| a | ≤ 1 % | 2.0 % | 50.0 % | no |" in all_new
    assert "old" not in all_new
    assert with_tables(all_new, lines, "Seeds.", whole=True) == all_new
    newer = with_tables(all_new, [line("One", "1.0 %"), line("Three", "4.0 %")], "About one.", whole=False)
    assert "### One\n\nAbout one.\n\n| figure |" in newer
    order = ["Before", "Seeds.", "### One", "1.0 %", "### Two", "3.0 %", "### Three", "4.0 %", "<!-- end -->", "behind"]
    assert sorted(order, key=newer.index) == order
    assert "2.0 %" not in newer
    with pytest.raises(ValueError, match="figures"):
        with_tables("nothing", lines, "Seeds.", whole=True)


def test_figures_of_several_cases_are_one_table():
    lines = [
        line("", "2.0 %", met=False, name="fog: off"),
        line("", "3.0 %", met=False, name="fog, bend: missed"),
        line("", "0.5 %", met=True, name="rain: off"),
        line("", "7.0 %", met=True, name="fog: missed", limit=8),
        line("", "9.0 %", met=True, name="rain: missed", limit=10),
    ]
    assert tables(lines).splitlines() == [
        "| case | off (≤ 1 %) | missed | coverage |",
        "|---|---|---|---|",
        "| fog | **2.0 %** | 7.0 %; ≤ 8 % | 50.0 % |",
        "| fog, bend |  | **3.0 %**; ≤ 1 % | 50.0 % |",
        "| rain | 0.5 % | 9.0 %; ≤ 10 % | 50.0 % |",
    ]


@pytest.mark.parametrize(
    ("bound", "by_scene", "shown"),
    [
        (at_most(1), {"bend": 2.0, "town": 0.5}, True),
        (at_most(1), {"bend": 2.0, "town": 1.5}, False),
        (at_most(1), {"bend": 0.4, "town": 0.0}, False),
        (at_most(0), {"bend": 1.0, "town": 0.0}, True),
        (at_least(95), {"bend": 99.0, "town": 90.0}, True),
        (at_least(95), {"bend": 90.0, "town": 88.0}, False),
        (at_most(None), {"bend": 2.0, "town": 0.5}, False),
    ],
)
def test_scenes_that_differ_are_shown_one_by_one(bound, by_scene, shown):
    class Found:
        def of(self, scenarios):
            return scenarios

    scenarios = tuple(Scenario(scene, drive(scene, scene=scene)) for scene in by_scene)
    figure = Figure("", "fog: off", bound, (scenarios,), lambda group: Value(by_scene[group[0].name]))
    names = [found.name for found, _ in figure.by_scene(Found())]
    assert names == [f"fog, {scene}: off" for scene in by_scene] * shown
    assert replace(figure, groups=(scenarios[:1],)).by_scene(Found()) == []


TINY = drive("tiny", scene="straight", width=160, height=120, seconds=0.3)
NOISY = Scenario("noisy", TINY, Noise(0.05), "surface,odometry,lanes")
WRONG = Scenario("wrong setting", TINY, Noise(0.05), "surface", ("surface.model=cube",))
ABSENT = Scenario("absent", "/no/such/recording")


@pytest.mark.long
def test_drives_are_rendered_once_and_replayed_and_failures_named(tmp_path):
    said = []
    results = run((NOISY, WRONG, ABSENT), tmp_path, first=7, count=1, jobs=1, said=said.append)
    tables = results.of((NOISY,))
    assert tables.frames.height == 3
    assert set(tables.frames["seed"]) == {7}
    assert set(tables.objects.columns) > {"distance_m", "true_distance_m"}
    assert len(said) == 2
    with pytest.raises(LookupError, match=r"surface\.model"):
        results.of((NOISY, WRONG))
    with pytest.raises(LookupError, match="no recording"):
        results.of((ABSENT,))
    (log,) = tmp_path.glob("tiny-*/7-*.mcap")
    before = log.stat().st_mtime_ns
    assert replay_source(TINY, 7, (NOISY,), tmp_path) == {}
    assert log.stat().st_mtime_ns == before
    assert not list(tmp_path.glob("tiny-7-*")), "dumps are gone"
