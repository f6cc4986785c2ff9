"""Fixtures every test may use."""

import os
from pathlib import Path

import pytest

DEFAULT_DATA = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real recordings: $ROADPERC_DATA, by default ../shared/data beside the checkout."""
    path = Path(os.environ.get("ROADPERC_DATA", DEFAULT_DATA))
    if not (path / "course_frames").is_dir():
        pytest.skip(f"no recordings at {path}; set ROADPERC_DATA to their folder")
    return path
