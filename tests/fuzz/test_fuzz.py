"""The corpus, and cases drawn anew: whatever is wrong with an input, a command ends with a result or one clear line.

CI draws 2000; for as many as one likes: make fuzz N=20000.
"""

import os

import pytest

from tests.fuzz.__main__ import main
from tests.fuzz.cases import recorded
from tests.fuzz.pool import Order, run

DRAWN = 200
JOBS = min(os.cpu_count() or 1, 4)


@pytest.fixture(scope="module")
def corpus():
    """The faults of every entry, by name."""
    return {order.case: verdict.faults for order, verdict in run([Order(name) for name in recorded()], JOBS)}


@pytest.mark.parametrize("name", recorded())
def test_what_was_found_once_is_answered(corpus, name):
    assert corpus[name] == []


def test_what_is_drawn_is_answered(capsys):
    code = main(["--count", str(DRAWN), "--jobs", str(JOBS), "--drawn", "--quick"])
    said = capsys.readouterr().out
    assert code == 0, said
    assert f"\n{DRAWN} cases in " in f"\n{said}"
