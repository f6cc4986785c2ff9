"""Settings from TOML and the command line."""

import pytest

from roadperc_stream.config import ReplayConfig, load_config
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
        ("lanes.hold_s=-1", "lanes.hold_s"),
        ("lanes.model=spiral", "lanes.model"),
        ('surface.classes=["rode"]', "rode"),
        ("stereo.block_px=4", "must be odd"),
        ("stereo.disparities=100", "multiple of 16"),
        ("stereo.p1=800", "p2 must exceed p1"),
        ("seed.x=1", "seed"),
        ("tag_table=newest", "tag_table"),
        ("lanes.holds_s=1", r"^no setting lanes\.holds_s; did you mean lanes\.hold_s\?"),
        ("lane.hold_s=1", r"did you mean lanes\?"),
        ("surface.zzz=1", "known: implementation, implementation_source, enabled, model"),
        ("hold_s=1", r"no setting hold_s; did you mean lanes\.hold_s or objects\.hold_s\?"),
        ("lanes.hold_s=0.8 s", r"^lanes\.hold_s: expected a number 0 to 3600 \(s\), found '0\.8 s'$"),
        ("seed=1.5", r"^seed: expected a whole number 0 to .*, found 1\.5$"),
        ("lanes.enabled=maybe", "^lanes.enabled: expected true, false, found 'maybe'$"),
        ("stereo.disparities=x", r"^stereo\.disparities: expected a whole number 16 to 1024, .*; or auto \(px\), "),
        ("l", "^setting l: expected KEY=VALUE"),
        ("stereo.inlier=1", r"no setting stereo\.inlier; did you mean surface\.inlier_m\?"),
    ],
)
def test_an_invalid_setting_is_named(setting, message):
    with pytest.raises(ConfigError, match=message):
        load_config(None, ("seed=1", setting))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, r"mine\.toml: No such file"),
        ("a = = 1", r"mine\.toml: not TOML"),
        ("[lanes]\nhold = 1\n", r"mine\.toml: no setting lanes\.hold; did you mean lanes\.hold_s\?"),
    ],
)
def test_an_error_names_the_file(tmp_path, text, message):
    if text:
        (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_config(tmp_path / "mine.toml")


@pytest.mark.parametrize(("text", "classes"), [("road", ("road",)), ("road, sidewalk", ("road", "sidewalk"))])
def test_classes_by_commas(text, classes):
    assert load_config(None, (f"surface.classes={text}",)).surface.classes == classes


def test_numbers_must_be_finite():
    for section in ("sync", "stereo", "surface", "odometry", "lanes", "objects", "occupancy"):
        for name, field in type(getattr(ReplayConfig(), section)).model_fields.items():
            if isinstance(field.default, float):
                for wild in ("inf", "nan", "-inf", "1e300"):
                    with pytest.raises(ConfigError, match=name):
                        load_config(None, (f"{section}.{name}={wild}",))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("lanes.hold_s=0", "lanes.hold_s=-0.0"),
        ("lanes.hold_s=2", "lanes.hold_s=2.0"),
        ("surface.classes=car,truck", "surface.classes=truck,car,truck"),
        ("surface.classes=ground,road_line,road", "seed=0"),
        ("lanes.separators=guard_rail,rail_track,sidewalk,road_line", "seed=0"),
        ("occupancy.obstacle_classes=pedestrian,vehicle", "seed=0"),
    ],
)
def test_equal_settings_have_equal_digests(one, other):
    assert load_config(None, one).to_toml() == load_config(None, other).to_toml()
