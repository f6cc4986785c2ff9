"""A reason's sentence comes from one table; tables and logs store its source, code, values and causes."""

import re
from pathlib import Path
from string import Formatter

import pytest

import roadperc_stream
from roadperc_stream.model import MISSING_ROLES, TEMPLATES, Reason, reason_of
from roadperc_stream.model.reason import fields_of
from roadperc_stream.schemas.roles import ROLES

PACKAGE = Path(roadperc_stream.__file__).parent
EXAMPLES = {"d": -12, "g": 0.025, ".0f": 45.0, ".0%": 0.2, "": "left"}
WORDS = {
    "frame_id": "velo: 'top'",
    "detail": "52 bytes are not a valid PNG: cut off, \n{} lost",
    "known": "plumb_bob, other",
}


def example(code, cause=None):
    fields = [(name, spec or "") for _, name, spec, _ in Formatter().parse(TEMPLATES[code]) if name]
    values = tuple(WORDS.get(name, EXAMPLES[spec]) for name, spec in fields if name != "cause")
    sources = {"no_surface": "surface", "no_drivable_surface": "drivable"}
    because = Reason(sources.get(code, "lanes"), "no_plane", (7, 0.5)) if cause is None else cause
    return Reason("lanes", code, values, because if "cause" in fields_of(code) else None)


def test_every_code_has_a_template_and_every_template_is_used():
    source = "".join(path.read_text() for path in PACKAGE.rglob("*.py") if path.name != "reason.py")
    codes = set(re.findall(r"\bReason\(\s*[^,()]+,\s*\"(\w+)\"", source))
    assert codes | set(MISSING_ROLES) <= set(TEMPLATES)
    assert [code for code in TEMPLATES if f'"{code}"' not in source] == []
    assert {role for roles in MISSING_ROLES.values() for role in roles} <= set(ROLES)


@pytest.mark.parametrize("code", TEMPLATES)
def test_a_stored_reason_is_read_back(code):
    reason = example(code)
    assert reason_of(**reason.stored) == reason
    assert str(reason)


def test_a_sentence_in_plain_words():
    tilted = Reason("surface", "plane_tilted", (89.6, 30.0))
    assert str(tilted) == "surface: the points' plane is tilted by 90 degrees, expected at most 30"
    assert tilted.text == "the points' plane is tilted by 90 degrees, expected at most 30"
    lanes = Reason("lanes", "no_surface", cause=tilted)
    assert str(lanes) == f"lanes: no surface: {tilted.text}"
    assert str(Reason("odometry", "lost", cause=Reason("odometry", "no_image"))) == "odometry: lost, no image"


def test_causes_are_stored_at_any_depth():
    tilted = Reason("surface", "plane_tilted", (90.0, 30.0))
    drivable = Reason("drivable", "no_surface", cause=tilted)
    lanes = Reason("lanes", "no_drivable_surface", cause=drivable)
    stored = {"code": "no_drivable_surface", "values": ["90.0", "30.0"], "cause": "no_surface/plane_tilted"}
    assert lanes.stored == {"source": "lanes", **stored}
    assert reason_of(**lanes.stored) == lanes
    assert lanes.kind == (("lanes", "no_drivable_surface"), ("drivable", "no_surface"), ("surface", "plane_tilted"))


def test_the_kind_depends_on_words_not_on_numbers():
    size = Reason("image", "wrong_size", (64, 48, 320, 240))
    assert size.kind == Reason("image", "wrong_size", (640, 480, 320, 240)).kind
    assert size.kind != Reason("depth", "wrong_size", (64, 48, 320, 240)).kind
    by_mounting, by_height = (
        Reason("surface", "no_depth_plane_assumed", (word,)) for word in ("the mounting", "the assumed height")
    )
    assert by_mounting.kind != by_height.kind
    assert Reason("image", "undecodable", ("7 bytes",)).kind == Reason("image", "undecodable", ("8 bytes",)).kind


@pytest.mark.parametrize(
    ("code", "values", "cause"),
    [
        ("gone", ["1"], ""),
        ("no_image", ["1"], ""),
        ("no_plane", ["many", "0.2"], ""),
        ("no_plane", [None, "0.2"], ""),
        ("wrong_size", ["1"], ""),
        ("lost", [], ""),
        ("lost", [], "gone"),
        ("lost", [], "lost/" * 100_000 + "no_image"),
        ("no_image", [], "no_depth"),
    ],
)
def test_any_other_stored_fields_are_shown_as_they_are(code, values, cause):
    reason = reason_of("lanes", code, values, cause)
    assert reason.code == "other"
    assert str(reason).startswith(f"lanes: {code}")


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e+30", "-0.5", "1e-30"])
def test_numbers_of_any_size_are_read_back(number):
    reason = Reason("stereo", "wrong_baseline", (float(number), 0.001, 1000.0))
    assert f"gives a baseline of {number} m" in str(reason)
    assert str(reason_of(**reason.stored)) == str(reason)


@pytest.mark.parametrize(
    ("code", "values", "cause"),
    [
        ("no_image", (1,), None),
        ("wrong_size", (64, 48), None),
        ("no_surface", (), None),
        ("no_image", (), Reason("lanes", "no_depth")),
    ],
)
def test_values_that_do_not_fit_the_template_are_refused(code, values, cause):
    with pytest.raises(ValueError, match=f"{code}: expected"):
        Reason("lanes", code, values, cause)
