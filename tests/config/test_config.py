"""Settings from TOML and the command line."""

import pytest

from roadperc_stream.config import ReplayConfig, load_config
from roadperc_stream.config.catalogue import catalogue
from roadperc_stream.config.settings import FIXED, settings_in
from roadperc_stream.errors import ConfigError


def test_settings_win_over_the_file(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text("seed = 3\n[lanes]\nhold_s = 0.2\n")
    cfg = load_config(path, ("lanes.hold_s=0.8", 'surface.classes=["road"]', "lanes.model=line"))
    assert (cfg.seed, cfg.lanes.hold_s, cfg.surface.classes, cfg.lanes.model) == (3, 0.8, ("road",), "line")


def test_toml_comes_back_as_it_was(tmp_path):
    cfg = load_config(None, ("surface.inlier_m=0.07", "tag_table=0.9.15"))
    path = tmp_path / "c.toml"
    path.write_text(cfg.to_toml())
    assert load_config(path) == cfg
    assert cfg.tag_table == "carla-from-0.9.14"


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("lanes.hold=1", "lanes.hold"),
        ("lanes.hold_s=-1", "lanes.hold_s"),
        ("lanes.model=spiral", "lanes.model"),
        ('surface.classes=["rode"]', "rode"),
        ("stereo.block_px=4", "must be odd"),
        ("stereo.disparities=100", "multiple of 16"),
        ("stereo.p1=800", "p2 must exceed p1"),
        ("seed", "KEY=VALUE"),
        ("seed.x=1", "seed"),
        ("tag_table=newest", "tag_table"),
        ("lanes.hough_rho_px=inf", "lanes.hough_rho_px"),
        ("sync.max_wait_s=1e300", "sync.max_wait_s"),
        ("lanes.fit_strip_m=nan", "lanes.fit_strip_m"),
        ("lanes.holds_s=1", r"^no setting lanes\.holds_s; did you mean lanes\.hold_s\?"),
        ("lane.hold_s=1", r"did you mean lanes\?"),
        ("surface.zzz=1", "known: enabled, model"),
        ("hold_s=1", r"no setting hold_s; did you mean lanes\.hold_s or objects\.hold_s\?"),
        ("lanes.hold_s=0.8 s", r"^lanes\.hold_s: expected a number 0 to 3600 \(s\), found '0\.8 s'$"),
        ("seed=1.5", r"^seed: expected a whole number 0 to .*, found 1\.5$"),
        ("lanes.enabled=maybe", "^lanes.enabled: expected true, false, found 'maybe'$"),
        ("stereo.disparities=x", r"^stereo\.disparities: expected a whole number 16 to 1024, .*; or auto \(px\), "),
        ("l", "^setting l: expected KEY=VALUE"),
        ("stereo.inlier=1", r"no setting stereo\.inlier; did you mean surface\.inlier_m\?"),
    ],
)
def test_what_does_not_fit_is_named(setting, message):
    with pytest.raises(ConfigError, match=message):
        load_config(None, ("seed=1", setting))


def test_an_unknown_key_of_a_file_is_named_with_the_nearest(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[lanes]\nhold = 1\n")
    with pytest.raises(ConfigError, match=r"mine\.toml: no setting lanes\.hold; did you mean lanes\.hold_s\?"):
        load_config(path)


OLD = """
seed = 3
[surface]
inlier_m = 0.07
drivable_m = 0.15
[lanes]
fit_huber = 3.0
"""
"""A file of a version in which two of the constants were settings, one with another value."""


def test_a_file_of_an_older_version_is_read_with_one_note(tmp_path):
    (tmp_path / "old.toml").write_text(OLD)
    with pytest.warns(UserWarning, match="older version") as notes:
        cfg = load_config(tmp_path / "old.toml", "lanes.hold_s=1")
    assert cfg == load_config(None, ("seed=3", "surface.inlier_m=0.07", "lanes.hold_s=1"))
    (note,) = notes
    assert str(note.message) == (
        f"{tmp_path / 'old.toml'}: 2 settings of an older version cannot be changed any more; lanes.fit_huber is 2.0"
    )


def test_of_an_attached_configuration_only_what_differs_from_the_constants_counts():
    assert settings_in(OLD.encode()) == {"seed": 3, "surface.inlier_m": 0.07, "lanes.fit_huber": 3.0}


def test_no_constant_is_a_setting():
    assert not FIXED.keys() & {setting.key for setting in catalogue()}


def test_broken_files(tmp_path):
    with pytest.raises(ConfigError, match=r"absent\.toml"):
        load_config(tmp_path / "absent.toml")
    (tmp_path / "b.toml").write_text("a = = 1")
    with pytest.raises(ConfigError, match="not TOML"):
        load_config(tmp_path / "b.toml")


def test_a_bare_class_and_classes_by_commas():
    assert load_config(None, ("surface.classes=road",)).surface.classes == ("road",)
    assert load_config(None, ("surface.classes=road, sidewalk",)).surface.classes == ("road", "sidewalk")


def test_every_number_refuses_what_is_not_finite():
    for section in ("sync", "stereo", "surface", "odometry", "lanes", "objects", "occupancy"):
        for name, field in type(getattr(ReplayConfig(), section)).model_fields.items():
            if isinstance(field.default, float):
                for wild in ("inf", "nan", "-inf", "1e300"):
                    with pytest.raises(ConfigError, match=name):
                        load_config(None, (f"{section}.{name}={wild}",))
