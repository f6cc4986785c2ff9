"""Commands on small logs, whole and broken, print what was recorded.

After an intended change, ``pytest tests/cli/test_recorded.py --force-regen`` records it again.
"""

from pathlib import Path

import pytest

from tests.errors_page import make_inputs
from tests.sessions import repeated

SESSIONS = sorted(Path(__file__).with_name("sessions").glob("*.txt"))


@pytest.mark.parametrize("session", SESSIONS, ids=lambda path: path.stem)
def test_a_session_equals_its_recording(session, tmp_path, capsys, monkeypatch, file_regression):
    make_inputs(tmp_path)
    file_regression.check(repeated(session, tmp_path, capsys, monkeypatch), fullpath=session)
