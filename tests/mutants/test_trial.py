import pytest

from tests.mutants import reach
from tests.mutants.faults import Fault
from tests.mutants.reach import Reach, TimedTest
from tests.mutants.trial import in_parts, planned

QUICK, SLOW = TimedTest("tests/test_other.py::quick", 0.1, True), TimedTest("tests/test_other.py::slow", 5.0, True)
NEAR, FAILING = TimedTest("tests/test_calc.py::near", 1.0, True), TimedTest("tests/test_calc.py::failing", 0.1, False)
REACHES = [
    Reach((SLOW, QUICK), {"p/calc.py": {3: (0, 1), 9: (1,)}}, ("p/calc.py",), {}),
    Reach((NEAR, FAILING), {"p/calc.py": {3: (0, 1)}}, ("p/calc.py", "p/names.py"), {}),
]


def fault(path="p/calc.py", lines=(3, 3), in_function=True):
    return Fault(path, 0, 0, lines[0], *lines, in_function, "", "")


@pytest.mark.parametrize(
    ("asked", "budget_s", "tests"),
    [
        (fault(), 60.0, (NEAR, QUICK, SLOW)),
        (fault(), 2.0, (NEAR, QUICK)),
        (fault(), 0.0, (NEAR,)),
        (fault(lines=(8, 10)), 60.0, (QUICK,)),
        (fault(lines=(20, 20)), 60.0, (NEAR, QUICK, SLOW)),
        (fault(lines=(1, 1), in_function=False), 60.0, (NEAR, QUICK, SLOW)),
        (fault("p/names.py", in_function=False), 60.0, (NEAR,)),
        (fault("p/nobody.py"), 60.0, ()),
    ],
    ids=["named first, quick first", "budget", "one at least", "line", "unreached line", "import", "importer", "none"],
)
def test_the_nearest_tests_are_run(asked, budget_s, tests):
    assert planned(asked, REACHES, budget_s).tests == tests


def test_the_first_cases_of_each_test_come_before_many_of_one():
    many = tuple(TimedTest(f"tests/test_other.py::many[{k}]", 0.1 + k / 100, True) for k in range(6))
    known = Reach((*many, SLOW), {"p/calc.py": {3: tuple(range(7))}}, ("p/calc.py",), {})
    assert planned(fault(), [known], 60.0).tests == (*many[:3], SLOW, *many[3:])


def test_a_recording_of_a_package_is_near_to_all_below_it():
    recorded = TimedTest("tests/chain/test_recorded.py::all", 3.0, True)
    known = Reach((QUICK, recorded), {"p/chain/stages/calc.py": {3: (0, 1)}, "p/view/calc.py": {3: (0, 1)}}, (), {})
    assert planned(fault("p/chain/stages/calc.py"), [known], 60.0).tests == (recorded, QUICK)
    assert planned(fault("p/view/calc.py"), [known], 60.0).tests == (QUICK, recorded)


def test_the_first_files_are_run_before_the_others_are_imported():
    tests = tuple(TimedTest(f"tests/test_{name}.py::{k}", 0.1, True) for k, name in enumerate("abacbd"))
    assert [[test.nodeid[-4:] for test in part] for part in in_parts(tests)] == [
        ["y::0", "y::1", "y::2", "y::4"],
        ["y::3", "y::5"],
    ]
    assert in_parts(tests[:3]) == [tests[:3]]
    assert in_parts(()) == []


def test_a_test_hangs_when_it_takes_much_longer_than_the_slowest():
    assert planned(fault(), REACHES, 60.0).patience_s == 60.0 + 8.0 * 5.0


def test_what_is_kept_comes_back(tmp_path):
    for known in REACHES:
        reach.save(known, tmp_path / "kept" / "a.json")
        assert reach.load(tmp_path / "kept" / "a.json") == known


def test_kept_until_a_file_changes(tmp_path):
    file = tmp_path / "a.py"
    file.write_text("x = 1")
    known = Reach((), {}, (), {str(file): reach.digest(str(file))})
    assert reach.is_fresh(known)
    file.write_text("x = 2")
    assert not reach.is_fresh(known)
    file.unlink()
    assert not reach.is_fresh(known)
