"""What is said of a folder where a log was expected."""

from roadperc_stream.system.folders import not_a_log


def test_the_first_log_in_it_is_named(tmp_path):
    for name in ("b.mcap", "a.mcap", "0.txt"):
        (tmp_path / name).touch()
    both = f", or its 2 files as the parts of one: {tmp_path}/*.mcap"
    assert not_a_log(tmp_path) == f"{tmp_path}: is a folder, expected a log, such as {tmp_path / 'a.mcap'}{both}"
    (tmp_path / "b.mcap").unlink()
    assert not_a_log(tmp_path) == f"{tmp_path}: is a folder, expected a log, such as {tmp_path / 'a.mcap'}"


def test_a_dump_becomes_one_by_a_command(tmp_path):
    dump = tmp_path / "a drive"
    dump.mkdir()
    assert not_a_log(dump).endswith(f"a CARLA dump becomes one with: roadperc-convert '{dump}' '{dump}.mcap'")
