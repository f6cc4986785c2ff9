"""Replays of scenarios: logs are rendered once, and failures have a reason."""

import pytest

from tests.accuracy.drives import Noise, drive
from tests.accuracy.running import replay_source, run
from tests.accuracy.scenarios import Scenario

TINY = drive("tiny", scene="straight", width=160, height=120, seconds=0.3)
NOISY = Scenario("noisy", TINY, Noise(0.05), "surface,odometry,lanes")
WRONG = Scenario("wrong setting", TINY, Noise(0.05), "surface", ("surface.model=cube",))
ABSENT = Scenario("absent", "/no/such/recording")


@pytest.mark.long
def test_drives_are_rendered_once_and_replayed_and_failures_named(tmp_path):
    said = []
    results = run((NOISY, WRONG, ABSENT), tmp_path, first=7, count=1, jobs=1, said=said.append)
    replays = results.of((NOISY,))
    assert sorted(replay.seed for replay in replays) == [7]
    assert all(replay.frames.height == 3 for replay in replays)
    assert set(replays[0].objects.columns) > {"distance_m", "true_distance_m"}
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
