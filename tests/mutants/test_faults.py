import ast

import pytest

from tests.mutants.faults import Fault, faults_in, faulty

ARITHMETIC = "def f(a, b):\n    return a + b * 2\n"


def changes(source: str) -> set[tuple[str, str]]:
    return {(fault.old, fault.new) for alternatives in faults_in("a.py", source) for fault in alternatives}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("a < b", {("a < b", "a <= b"), ("a < b", "a >= b")}),
        ("a is None", {("a is None", "a is not None")}),
        ("a not in b", {("a not in b", "a in b")}),
        ("a < b == c", {("a < b == c", "a <= b == c"), ("a < b == c", "a >= b == c"), ("a < b == c", "a < b != c")}),
        ("a and b", {("a and b", "a or b")}),
        ("not a", {("not a", "a")}),
        ("-a", {("-a", "a")}),
        ("a / b", {("a / b", "a * b")}),
        ("a @ b", set()),
        ("a % b", {("a % b", "a * b")}),
        ("'%d' % b", set()),
        ("a[0]", {("0", "1"), ("0", "-1")}),
        ("f(1000)", {("1000", "2000"), ("1000", "500")}),
        ("f(0.5, 0.0)", {("0.5", "1.0"), ("0.5", "0.25"), ("0.0", "1.0")}),
        ("f(exact=True)", {("True", "False")}),
        ("np.min(a)", {("np.min(a)", "np.max(a)")}),
        ("any(a)", {("any(a)", "all(a)")}),
        ("a if b else c", {("b", "not b")}),
        ("[a for a in b if a.known]", {("a.known", "not a.known")}),
        ("f'{a - b:4.1f}'", {("a - b", "a + b")}),
        ("lambda a=1: a", {("1", "2"), ("1", "0")}),
    ],
)
def test_an_expression_has_these_faults(source, expected):
    assert changes(f"x = {source}") == expected


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("if a:\n    pass\nelif b > c:\n    pass", {("a", "not a"), ("b > c", "b >= c"), ("b > c", "b <= c")}),
        ("while f(a):\n    pass", {("f(a)", "not f(a)")}),
        ("def f(a=0, *, b=True): ...", {("0", "1"), ("0", "-1"), ("True", "False")}),
        ("with a(1) as b:\n    c(True)", {("1", "2"), ("1", "0"), ("True", "False")}),
        ("try:\n    a()\nexcept E:\n    b(True)", {("True", "False")}),
        ("match a:\n    case 1:\n        b(True)", {("True", "False")}),
        ("class A(B, option=True):\n    x: int = field(default=False)", {("True", "False"), ("False", "True")}),
    ],
)
def test_a_statement_has_these_faults(source, expected):
    assert changes(source) == expected


@pytest.mark.parametrize(
    "source",
    [
        '"""Says 1 + 1."""',
        "raise ValueError(f'{a + 1} of 3')",
        "assert a > 0",
        "__all__ = ['a', 1]",
        "Number = int | float",
        "x: Literal[1, 2]",
        "Mode = Literal[0, 1]",
        "def f(a: tuple[int, 3]) -> Annotated[int, 4]: ...",
        "@cache(maxsize=8)\ndef f(): ...",
        "@dataclass(frozen=True)\nclass A: ...",
        "zip(a, b, strict=True)",
        "if TYPE_CHECKING:\n    x = 1",
        "if __name__ == '__main__':\n    main(1)",
        "x = f'{a:4.1f}'",
    ],
)
def test_what_nobody_would_meet_has_no_fault(source):
    assert changes(source) == set()


def test_each_fault_changes_its_place_alone_and_runs():
    results = []
    for alternatives in faults_in("a.py", ARITHMETIC):
        for fault in alternatives:
            scope: dict = {}
            exec(compile(faulty(ARITHMETIC, fault.place, fault.choice), "a.py", "exec"), scope)
            results.append((fault.old, fault.new, scope["f"](10, 8)))
    assert results == [
        ("a + b * 2", "a - b * 2", -6),
        ("b * 2", "b / 2", 14),
        ("2", "3", 34),
        ("2", "1", 18),
    ]


def test_a_negation_keeps_what_it_negates():
    assert ast.unparse(faulty("if a:\n    b()", 0, 0)) == "if not a:\n    b()"


def test_a_place_knows_its_statement_and_whether_it_waits_for_a_call():
    source = "LIMIT = 3\n\ndef f(a=1):\n    if (\n        a\n        > 2\n    ):\n        return\n"
    known = [(first.old, first.line, first.first_line, first.last_line, first.in_function)
             for first, *_ in faults_in("a.py", source)]  # fmt: skip
    assert known == [
        ("3", 1, 1, 1, False),
        ("1", 3, 3, 3, False),
        ("a > 2", 5, 4, 6, True),
        ("2", 6, 4, 6, True),
    ]


def test_a_long_expression_is_shown_around_its_change():
    source = f"x = {' + '.join(f'number_{k}' for k in range(30))} < last"
    shorter, longer = (fault for alternatives in faults_in("a.py", source)[:1] for fault in alternatives)
    assert shorter.old.endswith("number_29 < last")
    assert (shorter.new[-14:], longer.new[-14:]) == ("er_29 <= last"[-14:].rjust(14, "b"), "ber_29 >= last")


def test_a_fault_is_printed_as_its_place_and_change():
    assert str(Fault("a/b.py", 0, 0, 7, 7, 7, True, "a < b", "a <= b")) == "a/b.py:7 a < b -> a <= b"
