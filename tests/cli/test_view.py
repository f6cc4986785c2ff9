"""``roadperc-view``: its outputs, and wrong usage."""

import pytest

from roadperc_stream.cli.view import main
from roadperc_stream.config import load_config
from roadperc_stream.view import modes
from roadperc_stream.view.live import PlaybackOptions
from roadperc_stream.view.rerun import viewer
from tests import logs
from tests.replaying import replay
from tests.view.rerun.chunks import recorded


@pytest.fixture
def source(tmp_path):
    return logs.write(tmp_path / "in.mcap", logs.items(frames=2))


def test_save_writes_a_recording_and_says_so(source, capsys):
    target = source.with_suffix(".rrd")
    assert main([str(source), "--save", str(target)]) == 0
    assert f"wrote {target} (2 frames)" in capsys.readouterr().out
    assert "/camera/front/image" in recorded(target)


def test_the_command_that_opens_a_recording_is_quoted(tmp_path, capsys):
    (tmp_path / "my logs").mkdir()
    source = logs.write(tmp_path / "my logs" / "in.mcap", logs.items(frames=0))
    target = source.with_suffix(".rrd")
    assert main([str(source), "--save", str(target)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"wrote {target}; open it with: rerun '{target}'"


@pytest.mark.parametrize("option", ["--save", "--foxglove-layout", "--video", "--frame=0 --png"])
def test_a_log_is_not_replaced_by_another_kind_of_file(source, option, capsys):
    other = source.with_name("other.mcap")
    other.write_bytes(b"a log")
    if "--png" in option:
        replay(source, source := source.with_name("out.mcap"), load_config(None, ()))
    assert main([str(source), *option.split(), str(other), "--force"]) == 1
    assert f"error: {other}: expected a name that ends in ." in capsys.readouterr().err
    assert other.read_bytes() == b"a log"


@pytest.mark.parametrize("options", [[], ["--save", "a.rrd"], ["--foxglove-layout", "a.json"]])
def test_a_log_with_nothing_to_show_is_an_error(tmp_path, options, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    logs.write(tmp_path / "in.mcap", [], extra=[logs.foreign()])
    assert main(["in.mcap", *options]) == 1
    assert capsys.readouterr().err == (
        "error: in.mcap: no topic that roadperc-view can show; try rerun in.mcap or roadperc-view in.mcap --foxglove\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


def test_topics_of_other_names_fill_roles_in_a_recording_and_in_a_layout(tmp_path):
    items = [logs.Item(i.role, i.stamp_ns, i.data, "/a" if i.role == "image" else "") for i in logs.items(frames=1)]
    source = logs.write(tmp_path / "in.mcap", items)
    target, layout = tmp_path / "in.rrd", tmp_path / "layout.json"
    assert main([str(source), "--save", str(target), "--topic", "left=/a", "--quiet"]) == 0
    assert "EncodedImage" in recorded(target)["/a"].archetypes
    assert main([str(source), "--foxglove-layout", str(layout), "--topic", "image=/a", "--quiet"]) == 0
    assert '"imageTopic": "/a"' in layout.read_text("utf-8")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "expected a log"),
        (["in.mcap", "--save", "a.rrd", "--foxglove"], "not allowed with"),
        (["in.mcap", "--rate", "2"], "--rate needs --foxglove"),
        (["in.mcap", "--save", "a.rrd", "--start", "1"], "--start needs --foxglove"),
        *((["in.mcap", "--foxglove", f"--rate={rate}"], "--rate: ") for rate in ("0", "-1", "nan", "x")),
        (["in.mcap", "--foxglove", "--port=-1"], "--port: "),
        (["in.mcap", "--force"], "--force needs"),
        (["in.mcap", "--foxglove", "--topic", "image=/a"], "--topic ROLE=/NAME applies only"),
        (["--foxglove-layout", "a.json", "--topic", "image=/a"], "expected a log"),
        (["--foxglove-layout", "a.json", "--foxglove"], "expected a log"),
        (["in.mcap", "--foxglove-layout", "a.json", "--video", "a.mp4"], "cannot be combined with --save, --png or"),
        (["in.mcap", "--png", "a.png"], "--png shows one frame; pass --frame N"),
        (["in.mcap", "new.mcap", "--frame", "1", "--png", "a.png"], "--png shows one log"),
        (["in.mcap", "--video", "a.mp4", "--topic", "image=/a"], "--topic ROLE=/NAME applies only"),
        (["in.mcap", "--video", "a.mp4", "--topic", "/a", "--topic", "/b"], "expected the topic of one picture"),
    ],
)
def test_wrong_usage_has_exit_code_2(options, said, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(options)
    assert stopped.value.code == 2
    assert said in capsys.readouterr().err


def test_the_layout_needs_no_log(tmp_path, capsys):
    target = tmp_path / "layout.json"
    assert main(["--foxglove-layout", str(target)]) == 0
    assert capsys.readouterr().out == f"wrote {target}\n"
    assert main(["--foxglove-layout", str(target)]) == 1
    capsys.readouterr()
    assert main(["--foxglove-layout", str(target), "--force", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("timed", "given", "expected"),
    [
        (True, [], PlaybackOptions(1.0, False, "127.0.0.1", 8765, 0.0)),
        (
            False,
            ["--rate", "0.5", "--loop", "--host", "::1", "--port", "0", "--start", "1.5", "--quiet"],
            PlaybackOptions(0.5, True, "::1", 0, 1.5),
        ),
    ],
)
def test_a_log_is_served_as_the_options_say_and_its_layout_has_its_times(tmp_path, monkeypatch, timed, given, expected):
    source = logs.write(tmp_path / "in.mcap", logs.items(frames=2))
    replay(source, tmp_path / "out.mcap", load_config(None, ()))
    if not timed:
        (tmp_path / "out.metrics.parquet").unlink()
    served, target = [], tmp_path / "layout.json"
    monkeypatch.setattr(modes, "serve_log", lambda file, options, *, quiet: served.append((file.path, options, quiet)))
    assert main([str(tmp_path / "out.mcap"), "--foxglove", "--foxglove-layout", str(target), *given]) == 0
    assert served == [(tmp_path / "out.mcap", expected, "--quiet" in given)]
    assert ("/perception/times.total_ms" in target.read_text("utf-8")) is timed


@pytest.mark.parametrize("content", [None, b"", b"no log"])
def test_a_file_that_is_not_a_log_is_one_line_and_exit_code_1(tmp_path, content, capsys):
    source = tmp_path / "in.mcap"
    if content is not None:
        source.write_bytes(content)
    assert main([str(source), "--save", str(tmp_path / "out.rrd")]) == 1
    assert main([str(source)]) == 1
    errors = capsys.readouterr().err.splitlines()
    assert [line.startswith(f"error: {source}") for line in errors] == [True, True]
    assert not (tmp_path / "out.rrd").exists()


def test_a_viewer_without_a_display_is_a_stated_error(source, monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(viewer, "_listening", lambda: False)
    assert main([str(source)]) == 1
    assert "does not start" in capsys.readouterr().err
