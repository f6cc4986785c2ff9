"""Rendered dumps for tests."""

from functools import cache

import pytest

from roadperc_stream.cli.render import main
from tests.tools.rendered import Dump


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Render a dump once for each set of options, without pictures in colour unless a test needs them."""

    @cache
    def render(*options, colour=False):
        folder = tmp_path_factory.mktemp("render") / "dump"
        size = () if "--size" in options else ("--size", "160x120")
        cameras = () if colour else ("--without", "rgb", "--without", "right")
        assert main([str(folder), *size, *cameras, "--rate", "1", *options]) == 0
        return Dump(folder)

    return render
