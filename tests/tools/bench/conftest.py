"""The bench's own drive, small."""

import pytest

from roadperc_stream.tools.bench.inputs import drive, prepared


@pytest.fixture(scope="session")
def bench_logs(tmp_path_factory):
    return prepared(tmp_path_factory.mktemp("bench"), drive(4, (320, 240)))
