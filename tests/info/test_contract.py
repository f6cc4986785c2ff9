"""Contracts of recordings: good logs of a car keep the one that other logs of it teach, and each fault breaks it."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli.convert import main as convert
from roadperc_stream.cli.info import main as info
from roadperc_stream.cli.render import main as render
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ConfigError
from roadperc_stream.info.contract import (
    KEYS,
    KEYS_OF_LOG,
    Contract,
    broken,
    learned,
    read_contract,
    record,
    write_contract,
)
from roadperc_stream.model import Transform
from roadperc_stream.output import encoding
from tests import logs
from tests.analytic import box
from tests.batch.dataset import batch
from tests.commands import ROOT
from tests.info import faults
from tests.info.faults import FAULTS, IMAGE, OWN, POSE
from tests.replaying import replay

FRAMES = 30
SIDE = 160, 120
CFG = ReplayConfig()


def drive(seed):
    """The messages of 3 s at 10 Hz of a car with a stereo camera; the seed gives place, noise and boxes."""
    rng = np.random.default_rng(seed)
    road = replace(logs.SMALL, width=SIDE[0], height=SIDE[1], left_m=1.8 + rng.uniform(-0.2, 0.2))
    camera = road.camera
    made = [item for item in logs.items(0, road) if item.role == "calibration"]
    right = replace(camera, frame_id="camera_right", baseline_m=0.5)
    made.append(logs.Item("right_calibration", logs.START_NS, encoding.encode_calibration(logs.START_NS, right)))
    aside = road.ego_T_camera.copy()
    aside[1, 3] = -0.5
    edges = [Transform("ego", "camera", road.ego_T_camera), Transform("ego", "camera_right", aside)]
    made.append(logs.Item("tf", logs.START_NS, encoding.encode_transforms(logs.START_NS, edges)))
    for k in range(FRAMES):
        stamp_ns = logs.START_NS + 100 * faults.MS * k
        sensors = {item.role: item for item in logs.frame_items(stamp_ns, logs.shifted(road, k))}
        grey = cv2.imdecode(np.frombuffer(_file(sensors["segmentation"]), np.uint8), cv2.IMREAD_GRAYSCALE)
        for role, frame_id in (("image", "camera"), ("right", "camera_right")):
            noisy = np.clip(grey + rng.normal(0, 4, grey.shape), 0, 255).astype(np.uint8)
            data = encoding.encode_image(stamp_ns, frame_id, "png", cv2.imencode(".png", noisy)[1].tobytes())
            sensors[role] = logs.Item(role, stamp_ns, data)
        boxes = [box("Car", x, 60, x + 30, 90) for x in rng.uniform(0, 120, rng.integers(2, 6))]
        data = encoding.encode_detections(stamp_ns, "camera", boxes)
        sensors["detections"] = logs.Item("detections", stamp_ns, data)
        pose = encoding.encode_pose(stamp_ns, "odom", np.eye(4))
        sensors["truth_pose"] = logs.Item("truth_pose", stamp_ns, pose)
        made += sensors.values()
    return faults.with_own_topic([logs.message(item, number) for number, item in enumerate(made)])


def _file(item):
    return faults.content(logs.message(item, 0)).data


def written(path, messages):
    with log.LogWriter(path) as writer:
        for message in messages:
            writer.write(message)
    return path


def recorded(path, messages):
    return record([written(path, messages)], {}, CFG)


@pytest.fixture(scope="module")
def contract(tmp_path_factory):
    folder = tmp_path_factory.mktemp("contract")
    return learned([recorded(folder / f"{seed}.mcap", drive(seed)) for seed in (1, 2)])


@pytest.fixture(scope="module")
def good():
    return drive(3)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_another_good_log_keeps_the_contract(contract, tmp_path, seed):
    assert broken(recorded(tmp_path / "a.mcap", drive(seed)), contract) == ()


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_breaks_the_limit_that_names_it(contract, good, tmp_path, fault):
    make, topic, key = FAULTS[fault]
    found = broken(recorded(tmp_path / "a.mcap", make(good)), contract)
    assert (topic, key) in {(one.topic, one.key) for one in found}, found


RENDERED = [(scene, seed) for seed in (1, 2, 3) for scene in ("town", "straight", "bend")] + [("hill", 4)]


@pytest.mark.long
def test_ten_rendered_logs_keep_the_contract_of_three_and_every_fault_breaks_it(tmp_path):
    messages = [faults.with_own_topic(rendered(tmp_path, *scene)) for scene in (*RENDERED, ("bend", 5), ("town", 6))]
    recordings = [recorded(tmp_path / f"{k}.mcap", some) for k, some in enumerate(messages)]
    contract = learned(recordings[:3])
    assert [broken(recording, contract) for recording in recordings] == [()] * len(recordings)
    for number, (fault, (make, topic, key)) in enumerate(FAULTS.items()):
        good = messages[3 + number % (len(messages) - 3)]
        found = broken(recorded(tmp_path / f"{fault}.mcap", make(good)), contract)
        assert (topic, key) in {(one.topic, one.key) for one in found}, (fault, found)


def rendered(folder, scene, seed):
    dump, path = folder / f"{scene}{seed}", folder / f"{scene}{seed}.mcap"
    options = ("--size", "320x240", "--rate", "10", "--seconds", "3", "--scene", scene, "--seed", seed)
    assert render([str(dump), *map(str, options)]) == 0
    assert convert([str(dump), str(path)]) == 0
    return list(log.read(log.summarise(path)))


def test_a_place_is_printed_with_what_was_expected_and_found(contract, good, tmp_path):
    make, topic, key = FAULTS["another resolution for one image"]
    found = [str(one) for one in broken(recorded(tmp_path / "a.mcap", make(good)), contract) if one.key == key]
    at_ns = logs.START_NS + 1200 * faults.MS
    assert found == [f"{topic}: sizes: expected 160x120, found 80x60 at 1.200 s ({at_ns} ns)"]


def test_a_renamed_topic_is_proposed(contract, good, tmp_path):
    make, _, _ = FAULTS["own topic renamed"]
    (found,) = broken(recorded(tmp_path / "a.mcap", make(good)), contract)
    assert str(found) == (
        "/vehicle/speed: topic: expected vehicle.Speed (json), found no message; is it /vehicle/velocity now?"
    )


def test_a_topic_of_some_logs_is_optional(good, tmp_path):
    without, _, _ = FAULTS["truth gone"]
    recordings = [recorded(tmp_path / "a.mcap", good), recorded(tmp_path / "b.mcap", without(good))]
    contract = learned(recordings)
    assert contract.topics[POSE]["optional"] is True
    assert [broken(recording, contract) for recording in recordings] == [(), ()]
    assert "optional" not in contract.topics[IMAGE]


def test_more_logs_only_widen_the_limits(good, tmp_path):
    recordings = [recorded(tmp_path / f"{seed}.mcap", drive(seed)) for seed in range(4)]
    few, many = learned(recordings[:1]), learned(recordings)
    for topic, limits in few.topics.items():
        for key, limit in limits.items():
            wider = many.topics[topic][key]
            if isinstance(limit, tuple) and limit and isinstance(limit[0], float):
                assert wider[0] <= limit[0] <= limit[1] <= wider[1], (topic, key)
            elif isinstance(limit, float):
                assert limit <= wider, (topic, key)


def test_events_get_wide_limits(good, tmp_path):
    channel = next(message.channel for message in good if message.channel.topic == OWN)

    def with_events(seed):
        times = np.cumsum(np.random.default_rng(seed).exponential(0.3, 12)) * 1e9
        events = [logs.Message(channel, logs.START_NS + int(at_ns), 0, 0, b"{}") for at_ns in times if at_ns < 2.9e9]
        rest = [message for message in good if message.channel.topic != OWN]
        return recorded(tmp_path / f"{seed}.mcap", sorted((*rest, *events), key=lambda message: message.log_time_ns))

    contract = learned([with_events(seed) for seed in range(3)])
    assert [broken(with_events(seed), contract) for seed in range(3, 10)] == [()] * 7


def test_several_files_are_one_log(contract, good, tmp_path):
    middle = len(good) // 2
    paths = [written(tmp_path / "a.mcap", good[:middle]), written(tmp_path / "b.mcap", good[middle:])]
    assert broken(record(paths, {}, CFG), contract) == ()


def test_a_contract_that_is_written_and_read_again_is_the_same(contract, tmp_path):
    strange = {'/"quoted" \\ name\n': {"types": ('a "type"',), "rate_hz": (1.5, math.inf), "optional": True}}
    whole = Contract(log=contract.log, topics=contract.topics | strange)
    write_contract(tmp_path / "c.toml", whole, ["a\n.mcap"], force=False)
    assert read_contract(tmp_path / "c.toml") == whole


WRONG = {
    "": "limits nothing",
    '[topics."/a"]\nrate = [1, 2]': "/a: no key rate; did you mean rate_hz?",
    '[topics."/a"]\nrate_hz = [2, 1]': "/a: rate_hz: expected the lowest value first",
    '[topics."/a"]\nrate_hz = "fast"': "rate_hz: expected a number, two numbers, a list",
    '[topics."/a"]\nsizes = 3': "/a: sizes: expected a list of names, found 3",
    '[topics."/a"]\noptional = 3': "/a: optional: expected true or false",
    '[topics."/a"]\ngap_s = nan': "/a: gap_s: expected a number",
    "[log]\nlength_s = 3": "log: no key length_s",
    "[topic]\n": "topic",
}


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_contract_is_named(tmp_path, text):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(ConfigError) as error:
        read_contract(tmp_path / "c.toml")
    assert str(error.value).startswith(f"{tmp_path / 'c.toml'}: ")
    assert WRONG[text] in str(error.value)


def test_the_page_names_every_key():
    page = (ROOT / "docs" / "recordings.md").read_text()
    assert [key for key in (*KEYS, *KEYS_OF_LOG) if f"`{key}`" not in page] == []


def called(capsys, *arguments):
    code = info([str(argument) for argument in arguments])
    return code, *capsys.readouterr()


def test_the_command_learns_and_judges(capsys, good, tmp_path):
    logs_of = [written(tmp_path / f"{seed}.mcap", drive(seed)) for seed in (1, 2, 3)]
    file = tmp_path / "c.toml"
    code, out, _ = called(capsys, *logs_of[:2], "--init", file)
    assert (code, out) == (0, f"wrote {file}: 10 topics, learned from 2 logs\n")
    assert called(capsys, *logs_of[:2], "--init", file)[0] == 1  # exists
    assert called(capsys, *logs_of[:2], "--init", file, "--force")[0] == 0
    assert called(capsys, *logs_of, "--contract", file)[0] == 0
    slow = written(tmp_path / "slow.mcap", FAULTS["rate halved"][0](good))
    code, out, err = called(capsys, logs_of[2], slow, "--contract", file)
    assert (code, err) == (1, f"{file}: broken by 1 of 2 logs\n")
    assert f"{logs_of[2]}: keeps {file}\n" in out
    assert f"  {IMAGE}: rate_hz: expected 9 to 11, found 5" in out
    code, out, _ = called(capsys, slow, "--contract", file, "--json")
    facts = json.loads(out)
    assert (code, facts["kind"]) == (1, "input")
    (found,) = facts["contract"]["broken"]
    assert {"topic": IMAGE, "key": "rate_hz", "found": "5"}.items() <= found.items()


def test_a_cut_log_breaks_the_contract_and_no_log_cannot_be_judged(capsys, tmp_path):
    good, file = written(tmp_path / "a.mcap", drive(1)), tmp_path / "c.toml"
    called(capsys, good, "--init", file)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(good.read_bytes()[: good.stat().st_size * 2 // 3])
    code, out, _ = called(capsys, cut, "--contract", file)
    assert (code, "log: damages: expected at most 0, found 1 (cut off" in out) == (1, True)
    assert called(capsys, cut, "--init", tmp_path / "d.toml")[0] == 1  # nothing to learn from
    (tmp_path / "no.mcap").write_bytes(b"no log")
    code, out, err = called(capsys, tmp_path / "no.mcap", good, "--contract", file)
    assert (code, "keeps" in out, err.startswith(f"error: {tmp_path / 'no.mcap'}")) == (3, True, True)
    assert called(capsys, good, "--contract", tmp_path / "missing.toml")[0] == 3
    with pytest.raises(SystemExit, match="2"):
        called(capsys, good, "--contract", file, "--init", file)


def test_a_result_and_a_log_of_one_frame_are_judged_by_what_they_have(contract, good, tmp_path):
    source, result = written(tmp_path / "in.mcap", good), tmp_path / "out.mcap"
    replay(source, result, CFG)
    assert broken(record([result], {}, CFG), contract) == ()
    first_ns = good[0].log_time_ns
    found = broken(recorded(tmp_path / "one.mcap", [m for m in good if m.log_time_ns == first_ns]), contract)
    assert not [one for one in found if one.key.startswith("stamps_")]


def test_a_batch_records_what_each_log_breaks_and_goes_on(capsys, good, tmp_path):
    (tmp_path / "logs").mkdir()
    written(tmp_path / "logs" / "good.mcap", good[: len(good) // 3])
    written(tmp_path / "logs" / "bad.mcap", FAULTS["own topic gone"][0](good[: len(good) // 3]))
    called(capsys, tmp_path / "logs" / "good.mcap", "--init", tmp_path / "c.toml")
    arguments = (tmp_path / "out", tmp_path / "logs", "--only", "odometry")
    assert batch(*arguments).returncode == 0
    assert runs(tmp_path / "out") == {"good": (None, []), "bad": (None, [])}
    done = batch(*arguments, "--contract", tmp_path / "c.toml")  # judges without a replay
    name = read_contract(tmp_path / "c.toml").name
    missing = f"{OWN}: topic: expected vehicle.Speed (json), found no message"
    assert (done.returncode, f"{missing}\n" in done.stdout) == (0, True)
    assert runs(tmp_path / "out") == {"good": (name, []), "bad": (name, [missing])}
    assert f"{missing}\n" in batch(*arguments, "--contract", tmp_path / "c.toml").stdout


def runs(dataset):
    rows = pl.read_parquet(dataset / "runs.parquet").iter_rows(named=True)
    return {row["path"].rpartition("/")[2].removesuffix(".mcap"): (row["contract"], row["broken"]) for row in rows}


def test_a_new_finding_is_told_in_its_own_words(contract, good, tmp_path):
    def aside(found):
        found.K[2] = found.P[2] = 3.0

    messages = faults.edited(good, faults.FRONT, lambda message, _: faults.with_content(message, aside))
    found = {one.key: one.found for one in broken(recorded(tmp_path / "a.mcap", messages), contract)}
    assert found["cx"] == "3"
    assert found["findings"].startswith("principal_point (/camera/front/image: principal point (3, ")
