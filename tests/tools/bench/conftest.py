"""Small logs of the benchmark."""

import pytest

from roadperc_stream.tools.bench.inputs import bench_options, prepared


@pytest.fixture(scope="session")
def bench_logs(tmp_path_factory):
    return prepared(tmp_path_factory.mktemp("bench"), bench_options(4, (320, 240)))
