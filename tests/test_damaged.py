"""Replays of damaged logs: whole frames are replayed, and losses are reported."""

import shlex

import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli.info import main as info_main
from roadperc_stream.config import load_config
from roadperc_stream.errors import LogError
from roadperc_stream.log import Message
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.system.time import TimeRange
from tests import logs
from tests.analytic import STEP_NS
from tests.log.flips import flipped
from tests.replaying import replay
from tests.resume.parts import cut, inputs, write

OFF = ("odometry", "lanes", "objects", "occupancy")
CFG = load_config(None, [f"{stage}.enabled=false" for stage in OFF])
FRAMES = 10
"""At 20 Hz, a chunk holds about one of them."""


@pytest.fixture(autouse=True)
def _small_chunks(monkeypatch):
    monkeypatch.setattr("roadperc_stream.log.writing.CHUNK_SIZE_BYTES", 30_000)


@pytest.fixture
def whole(tmp_path):
    return logs.write(tmp_path / "in.mcap", logs.items(FRAMES))


@pytest.fixture
def damaged(whole):
    """The log with a wrong byte in a chunk of its sixth frame."""
    stamp = logs.START_NS + 5 * STEP_NS
    entries = log.Salvage(whole).run().index
    entry = next(e for e in entries if e.message_start_time <= stamp <= e.message_end_time)
    content = whole.read_bytes()
    path = whole.with_name("damaged.mcap")
    path.write_bytes(flipped(content, 8 * (entry.chunk_start_offset + entry.chunk_length - 50)))
    return path


def rows(path):
    table = pl.read_parquet(sidecar_path(path, "metrics"))
    return table.select(pl.exclude("log_id", "^.*_ms$"))


def run(source, name, cfg=CFG, **options):
    target = source.with_name(f"{name}.mcap")
    return target, replay(source, target, cfg, **options)


def test_frames_outside_the_damage_equal_the_whole_log(whole, damaged):
    before, (target, summary) = rows(run(whole, "whole")[0]), run(damaged, "out", recover=True)
    after = rows(target)
    missing = [stamp for stamp in before["stamp_ns"] if stamp not in after["stamp_ns"]]
    assert len(missing) in {1, 2}
    gap = after.filter(pl.col("reason_codes").list.contains("log.lost_to_damage"))
    assert 1 <= gap.height <= 2
    first = before.filter(pl.col("stamp_ns") < gap["stamp_ns"][0])
    assert first.height >= 4
    assert after.head(first.height).equals(first)
    last = after.filter(pl.col("stamp_ns") > gap["stamp_ns"][-1])
    assert last.height >= 2
    assert last.drop("frame").equals(before.tail(last.height).drop("frame"))
    assert after.height == FRAMES - len(missing)
    assert gap["stamp_ns"][-1] == next(stamp for stamp in after["stamp_ns"] if stamp > max(missing))
    assert any("damaged at byte" in warning for warning in summary.warnings)
    assert any("lost from 0." in warning for warning in summary.warnings)


def test_a_repaired_log_and_the_output_give_the_same_results(damaged):
    target, _ = run(damaged, "out", recover=True)
    repaired = damaged.with_name("repaired.mcap")
    log.write_repaired(damaged, repaired)
    from_repaired, summary = run(repaired, "from_repaired")
    again, _ = run(target, "again")
    assert summary.warnings == ()
    assert target.read_bytes() == from_repaired.read_bytes() == again.read_bytes()
    assert rows(target).equals(rows(again))


@pytest.mark.parametrize("part", [TimeRange(end_s=0.15), TimeRange(frames=3), TimeRange(start_s=0.4)])
def test_damage_outside_the_requested_part_is_a_warning(whole, damaged, part):
    expected, _ = run(whole, "whole", time_range=part)
    target, summary = run(damaged, "out", time_range=part)
    assert "damaged at byte" in summary.warnings[0]
    assert rows(target).drop("reasons", "reason_codes").equals(rows(expected).drop("reasons", "reason_codes"))


def test_damage_in_the_requested_part_is_an_error(damaged):
    for part in (TimeRange(end_s=0.3), TimeRange(start_s=0.1), TimeRange(frames=9)):
        with pytest.raises(LogError, match=r"damaged\.mcap: damaged at byte .*--recover"):
            run(damaged, "out", time_range=part)


def test_a_cut_log_gives_every_whole_frame(whole):
    content, path = whole.read_bytes(), whole.with_name("cut.mcap")
    for share in (0.3, 0.6, 0.9):
        path.write_bytes(content[: int(len(content) * share)])
        salvage = log.Salvage(path)
        images = sum(m.channel.topic == "/camera/front/image" for m in salvage.messages())
        target, summary = run(path, "out", recover=True, force=True)
        assert summary.frames == images == rows(target).height > 0


def test_recover_does_not_change_the_replay_of_a_whole_log(whole):
    plain, _ = run(whole, "plain")
    target, summary = run(whole, "out", recover=True, strict=True)
    assert plain.read_bytes() == target.read_bytes()
    assert summary.warnings == ()


def test_info_writes_and_reports_a_repaired_log(damaged, capsys):
    target = damaged.with_name("repaired.mcap")
    assert info_main([str(damaged)]) == 1
    assert (
        f"roadperc-info {shlex.quote(str(damaged))} --recover OUT.mcap writes the readable part as a new log"
        in capsys.readouterr().out
    )
    assert info_main([str(damaged), "--recover", str(target)]) == 0
    printed = capsys.readouterr().out
    assert "warning: lost from" in printed
    assert f"wrote {target}" in printed
    assert info_main([str(target)]) == 0
    printed = capsys.readouterr().out
    assert f"{target}: whole" in printed
    assert "repaired after damage:" in printed
    assert info_main([str(damaged), "--recover", str(target)]) == 1
    assert "--force" in capsys.readouterr().err
    assert info_main([str(damaged), "--recover", str(target), "--force"]) == 0


def with_bad(tmp_path, topic, data):
    """A log whose fourth frame has an unusable message."""
    source = logs.write(tmp_path / "plain.mcap", logs.items(6))
    stamp = logs.START_NS + 3 * STEP_NS
    path = tmp_path / "bad.mcap"
    with log.LogWriter(path) as writer:
        for message in log.read(log.summarise(source)):
            bad = message.channel.topic == topic and message.log_time_ns == stamp
            writer.write(Message(message.channel, stamp, stamp, 0, data) if bad else message)
    return path, stamp


def test_one_bad_message_is_skipped_unless_strict(tmp_path):
    path, stamp = with_bad(tmp_path, "/camera/front/detections", b"\xff\xff\xff")
    target, summary = run(path, "out")
    assert (summary.frames, summary.problems) == (6, {"/camera/front/detections": 1})
    with pytest.raises(LogError, match=rf"bad\.mcap: /camera/front/detections: message at {stamp} ns: .*--strict"):
        run(path, "strict", strict=True)
    assert not path.with_name("strict.mcap").exists()
    assert target.exists()


def test_losses_continue_in_a_continued_replay(tmp_path):
    """Repeated frames keep the reason, and the first frame after the gap has it too."""
    cfg = load_config(None, ["sync.max_wait_s=0.2", *(f"{stage}.enabled=false" for stage in OFF)])
    messages = inputs(logs.write(tmp_path / "all.mcap", logs.items(24)))
    cut_ns = logs.START_NS + 12 * STEP_NS
    first, second = (write(tmp_path / f"{k}.mcap", part) for k, part in enumerate(cut(messages, [cut_ns])))
    first.write_bytes(first.read_bytes()[: first.stat().st_size * 3 // 4])
    replay(first, tmp_path / "a.mcap", cfg, recover=True)
    replay(second, tmp_path / "b.mcap", cfg, continued=tmp_path / "a.mcap")
    said = [
        row["frame"] for row in rows(tmp_path / "b.mcap").to_dicts() if "log.lost_to_damage" in str(row["reason_codes"])
    ]
    last = rows(tmp_path / "a.mcap")["frame"].max()
    assert said
    assert set(said) <= {last, last + 1}
    assert last + 2 in rows(tmp_path / "b.mcap")["frame"].to_list(), "the gap ends where the next part begins"


def test_damage_in_the_warm_up_is_an_error(damaged):
    """The state would differ; with --recover it is built from the remaining frames."""
    target, part = damaged.with_name("out.mcap"), TimeRange(start_s=0.35)
    with pytest.raises(LogError, match="--recover"):
        replay(damaged, target, CFG, time_range=part, warm_up_s=0.2)
    assert replay(damaged, target, CFG, time_range=part, warm_up_s=0.2, recover=True).frames > 0
    assert replay(damaged, target, CFG, time_range=part, force=True).frames > 0, "the damage is outside"
