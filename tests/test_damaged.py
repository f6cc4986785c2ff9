"""Replays of damaged logs: whole frames are replayed, and losses are reported."""

import shlex
from random import Random

import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.api import frames
from roadperc_stream.cli.info import main as info_main
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.cli.view import main as view_main
from roadperc_stream.config import load_config
from roadperc_stream.errors import ChannelError, LogError
from roadperc_stream.input.source import LossTimes
from roadperc_stream.log import Channel, LostSpan, Message
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


def test_seconds_count_from_the_first_message_that_was_written(tmp_path):
    large = Message(Channel("/noise", "x"), logs.START_NS - 10**9, 0, 0, Random(0).randbytes(40_000))
    path = tmp_path / "headless.mcap"
    with log.LogWriter(path) as writer:
        writer.write(large)
        for message in log.read(log.summarise(logs.write(tmp_path / "plain.mcap", logs.items(6)))):
            writer.write(message)
    part = TimeRange(start_s=1.1, end_s=1.2)
    expected, _ = run(path, "whole", time_range=part)
    path.write_bytes(flipped(path.read_bytes(), 8 * 20_000))  # in the first chunk
    target, summary = run(path, "out", time_range=part)
    assert "lost from" in " ".join(summary.warnings)
    assert rows(target).drop("reasons", "reason_codes").equals(rows(expected).drop("reasons", "reason_codes"))


def test_a_lost_calibration_is_reported(whole):
    path = whole.with_name("headless.mcap")
    in_first_chunk = log.summarise(whole).source.chunks[0].chunk_start_offset + 100
    path.write_bytes(flipped(whole.read_bytes(), 8 * in_first_chunk))
    with pytest.raises(ChannelError, match=rf"^{path}: .*no calibration"):
        run(path, "out", recover=True)


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


def test_frames_of_a_damaged_log(damaged):
    given = list(frames(damaged, config=CFG, recover=True))
    assert len(given) >= FRAMES - 2
    assert any(reason.source == "log" for frame in given for reason in frame.metrics.reasons)


def test_replay_prints_what_was_lost(damaged, capsys):
    target = damaged.with_name("out.mcap")
    arguments = [str(damaged), str(target), "--only", "surface"]
    assert replay_main(arguments) == 1
    assert "--recover" in capsys.readouterr().err
    assert replay_main([*arguments, "--recover"]) == 0
    out = capsys.readouterr().out
    assert f"warning: {damaged}: damaged at byte" in out
    assert "warning: lost from 0." in out


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


def test_info_cannot_recover_a_log_without_a_whole_message(tmp_path, whole, capsys):
    path = tmp_path / "stump.mcap"
    path.write_bytes(whole.read_bytes()[:60])
    assert info_main([str(path), "--recover", str(tmp_path / "out.mcap")]) == 1
    assert "no message can be saved" in capsys.readouterr().err
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize("more", [["--json"], ["--topic", "image=/a"], ["other.mcap"]])
def test_info_recovers_one_log_without_other_options(damaged, more, capsys):
    with pytest.raises(SystemExit) as exited:
        info_main([str(damaged), *more, "--recover", "out.mcap"])
    assert exited.value.code == 2


def test_view_recovers_a_log(damaged, capsys):
    target = damaged.with_name("view.rrd")
    assert view_main([str(damaged), "--save", str(target)]) == 1
    assert "--recover" in capsys.readouterr().err
    assert view_main([str(damaged), "--save", str(target), "--recover"]) == 0
    assert "warning: lost from 0." in capsys.readouterr().out
    assert target.stat().st_size > 1000


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


def test_strict_stops_at_an_undecodable_image(tmp_path):
    from roadperc_stream.output import encoding  # noqa: PLC0415 - for this one

    stamp = logs.START_NS + 3 * STEP_NS
    path, _ = with_bad(tmp_path, "/camera/front/image", encoding.encode_image(stamp, "camera", "png", b"no png"))
    cfg = load_config()  # odometry looks at the image
    _, summary = run(path, "out", cfg)
    assert summary.frames == 6
    with pytest.raises(LogError, match=rf"bad\.mcap: message with stamp {stamp} ns: image: cannot be decoded"):
        run(path, "strict", cfg, strict=True)


@pytest.mark.parametrize(
    ("gap", "text"),
    [
        (LostSpan(10, 20), "log: messages between 10 and 20 ns were lost to damage"),
        (LostSpan(10, None), "log: messages from 10 ns on were lost to damage"),
        (LostSpan(None, 7), "log: messages up to 7 ns were lost to damage"),
        (LostSpan(None, None), "log: messages were lost to damage at an unknown time"),
    ],
)
def test_the_reason_for_a_gap_names_its_times(gap, text):
    assert str(LossTimes([gap]).reason(None, 30)) == text


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
