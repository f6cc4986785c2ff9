"""Which existing outputs a replay may replace."""

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.system.time import TimeRange
from tests.arranged import parts
from tests.replaying import replay
from tests.test_sample import SAMPLE


def test_a_damaged_output_is_replaced_because_only_its_index_says_who_wrote_it(tmp_path):
    files, out = parts(SAMPLE, tmp_path, [200]), tmp_path / "out.mcap"
    replay(files, out, ReplayConfig(), time_range=TimeRange(frames=2))
    whole = out.read_bytes()
    out.write_bytes(whole[:5000] + bytes([whole[5000] ^ 1]) + whole[5001:])
    assert "roadperc" in log.outline(out)[0]
    replay(files, out, ReplayConfig(), time_range=TimeRange(frames=2), force=True)
    assert out.read_bytes() == whole
