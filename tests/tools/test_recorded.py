"""Rendering and converting dumps, whole and broken, print what was recorded.

After an intended change, ``pytest tests/tools/test_recorded.py --force-regen`` records it again.
"""

from pathlib import Path

from tests.sessions import repeated


def test_a_session_equals_its_recording(tmp_path, capsys, monkeypatch, file_regression):
    session = Path(__file__).with_name("sessions") / "dumps.txt"
    file_regression.check(repeated(session, tmp_path, capsys, monkeypatch), fullpath=session)
