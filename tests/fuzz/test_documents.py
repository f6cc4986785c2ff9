"""Folders of frames, and documents: configurations, criteria, true lanes."""

import json
import tomllib

import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.config import ReplayConfig
from tests.fuzz import bases
from tests.fuzz.running import examples, folder_of, require_clear_end
from tests.fuzz.values import changed, damaged
from tests.logs import START_NS

ORIGIN = dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw"), 0.0)
BOXES = [{"label": "Car", "box_px": [1, 2, 8, 9], "score": 0.5}]
POSE = {"location": dict.fromkeys("xyz", 0.0), "rotation": dict.fromkeys(("roll", "pitch", "yaw"), 0.0)}
CALIBRATION = json.loads(bases.dump()["calibration.json"])
DOCUMENTS = {
    "calibration.json": CALIBRATION | {"mounting": {"rgb": ORIGIN, "depth": ORIGIN}, "rate_hz": 20, "baseline_m": 0.5},
    "detections.json": {"0": BOXES, "1": BOXES},
    "poses.json": {"0": POSE, "1": POSE},
}
TEXTS = {
    "timestamps.txt": b"0 0.0\n1 0.05\n",
    "timestamps.csv": b"frame,seconds\n0,0.0\n1,0.05\n",
    "poses.csv": b"frame,x,y,z,roll,pitch,yaw\n0,0,0,0,0,0,0\n1,1,0,0,0,0,0\n",
    "label_2/000000.txt": b"Car 0 0 0 1 2 8 9 1 1 1 0 0 5 0 0.9\n",
}
NAMES = ("1", "-1", "1305031102.933", "9" * 20, "1e5", "nan", "", "\x1b[31m5", "5\nx", "x" * 200, "[nope]7", "..5")
CRITERIA = {
    "criterion": [
        {"metric": "lane_left_error_m", "statistic": "p95", "most": 0.1, "least_coverage": 0.9, "filter": "frame > 0"},
        {"name": "losses", "statistic": "rate", "event": "lane_left_status = 'lost'", "most": 2, "per_log": True},
        {"column": "total_ms", "statistic": "share", "within": 100.0, "least": 0.5, "least_frames": 1},
    ],
}
LANES = {"raw_file": f"out/{START_NS}", "lanes": [[3, 4, 5], [20, -2, 25]], "h_samples": [12, 16, 20], "run_time": 1}


def as_json(tree):
    return json.dumps(tree).encode("utf-8", "surrogatepass")


@st.composite
def dumps(draw):
    """A dump with one to three files changed, renamed, exchanged or left out."""
    files = bases.dump() | {name: as_json(tree) for name, tree in DOCUMENTS.items()}
    files |= {name: TEXTS[name] for name in draw(st.sets(st.sampled_from(sorted(TEXTS)), max_size=2))}
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(files)))
        how = draw(st.sampled_from(("content", "content", "content", "rename", "exchange", "remove")))
        if how == "content":
            is_document = name in DOCUMENTS and draw(st.booleans())
            files[name] = as_json(draw(changed(DOCUMENTS[name]))) if is_document else draw(damaged(files[name]))
        elif how == "exchange":
            files[name] = files[draw(st.sampled_from(sorted(files)))]
        else:
            data = files.pop(name)
            if how == "rename":
                folder, _, last = name.rpartition("/")
                files[f"{folder}/{draw(st.sampled_from(NAMES))}.{last.rpartition('.')[2]}"] = data
    return {f"dump/{name.lstrip('/')}": data for name, data in files.items()}


@examples
@given(dumps(), st.sampled_from(("", "--depth float", "--fov 60 --rate 0.5", "--carla 0.9.10 --allow-lossy-tags")))
def test_a_dump(files, options):
    with folder_of(files) as folder:
        require_clear_end(folder, "convert", "dump", "in.mcap", *options.split())


@st.composite
def toml(draw, tree):
    """A TOML file with changed values, damaged bytes, or deep nesting."""
    intact = tomli_w.dumps(tree).encode()
    how = draw(st.sampled_from(("values", "values", "bytes", "deep")))
    if how == "deep":
        return draw(st.sampled_from((b"x = " + b"[" * 50_000, b"a." * 50_000 + b"a = 1", b"seed = " + b"9" * 5000)))
    if how == "values":
        try:
            return tomli_w.dumps(draw(changed(tree))).encode()
        except (TypeError, ValueError, AttributeError):  # the value has no TOML form
            pass
    return draw(damaged(intact))


@examples
@given(toml(tomllib.loads(ReplayConfig().to_toml())))
def test_a_configuration(text):
    with folder_of({"mine.toml": text}) as folder:
        require_clear_end(folder, "replay", "--print-config", "--config", "mine.toml")


@examples
@given(toml(CRITERIA), st.sampled_from(("check", "compare out.mcap")))
def test_criteria(text, command):
    with folder_of(bases.results() | {"mine.toml": text}) as folder:
        require_clear_end(folder, *command.split(), "out.mcap", "--criteria", "mine.toml")


@examples
@given(st.data(), st.sampled_from(("", "--pair order", "--size 1280x720", "--tusimple lanes.json")))
def test_true_lanes(data, options):
    line = as_json(data.draw(changed(LANES)))
    with folder_of(bases.results() | {"true.json": data.draw(st.just(line) | damaged(line))}) as folder:
        require_clear_end(folder, "lanes", "out.mcap", "--truth", "true.json", *options.split())
