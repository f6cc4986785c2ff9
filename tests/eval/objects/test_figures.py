"""Figures of detections and tracks over hand-made scenes, and in the commands."""

import json
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from roadperc_stream.cli.check import main as check
from roadperc_stream.cli.compare import main as compare
from roadperc_stream.cli.report import main as report
from roadperc_stream.eval.objects.detection import average_precision, curves
from roadperc_stream.eval.objects.figures import ObjectTally, figures, frame_values, tallies
from roadperc_stream.eval.objects.matching import greedy, near_pairs
from roadperc_stream.eval.report.sources import load, source_of_runs
from roadperc_stream.eval.report.summaries import groups_of_runs
from tests.eval.objects.scenes import random_scene, write_scene
from tests.eval.tables import outcome, run_of

FRAMES = 40


def scene(found, true=None, frames=FRAMES):
    """A scene of vehicles; the truth is a car 10 m ahead in all frames by default."""
    true = [(frame, 10.0, 0.0, 5.0, 1) for frame in range(frames)] if true is None else true
    return {"frames": frames, "classes": {"vehicle": (true, found)}}


def seen(frames, x_m=10.0, track=1, score=0.9):
    return [(frame, x_m, 0.0, 5.0, track, score) for frame in frames]


def tally_of_scene(folder, of, **more) -> ObjectTally:
    frames = load(source_of_runs([run_of(write_scene(folder, of, **more))]))
    (tally,) = tallies(frames, groups_of_runs(frames, ["all"]))
    return tally


def test_perfect_detections_have_perfect_figures(tmp_path):
    found = dict(figures(tally_of_scene(tmp_path, scene(seen(range(FRAMES))))))
    assert (found.pop("objects_ate_m"), found.pop("objects_ave_mps")) == (0.0, 0.0)
    assert found == dict.fromkeys(found, pytest.approx(1.0))
    assert {"objects_ap", "objects_ap.vehicle", "objects_ap.0-20m", "tracks_hota", "tracks_idf1"} <= found.keys()


def test_a_track_that_changes_half_way_costs_association_only(tmp_path):
    halves = [*seen(range(FRAMES // 2)), *seen(range(FRAMES // 2, FRAMES), track=2)]
    tally = tally_of_scene(tmp_path, scene(halves))
    found = tally.tracks.figures
    assert tally.tracks.switched == 1
    assert found["deta"] == pytest.approx(1.0)
    assert found["assa"] == pytest.approx(0.5)
    assert found["mota"] == pytest.approx(1 - 1 / FRAMES)
    assert found["idf1"] == pytest.approx(0.5)


def test_precision_over_falling_scores():
    precision, score = curves(np.array([0.9, 0.8, 0.1]), np.array([True, False, True]), 2)
    assert (precision[49], precision[100], score[100]) == pytest.approx((1.0, 2 / 3, 0.1))
    assert average_precision(np.ones(101)) == pytest.approx(1.0)
    assert average_precision(curves(np.array([0.9]), np.array([True]), 20)[0]) == 0.0


def test_a_detection_matches_the_nearest_free_object_of_its_frame():
    """The second detection is nearer to the first object, but the first one has the higher score."""
    true, places = np.array([(10.0, 0.0), (13.0, 0.0), (30.0, 0.0)]), np.array([(10.5, 0.0), (10.1, 0.0), (30.0, 0.0)])
    frame, score = np.array([0, 0, 1]), np.array([0.9, 0.8, 0.7])
    pairs = near_pairs(np.array([0, 0, 2]), true, frame, places)
    assert greedy(pairs, frame, score, 2.0).tolist() == [0, -1, -1]
    assert greedy(pairs, frame, score, 4.0).tolist() == [0, 1, -1]
    assert greedy(pairs, frame, score, 0.5).tolist() == [-1, 0, -1]


def test_a_hit_counts_in_the_ring_of_the_true_object(tmp_path):
    true = [(frame, 19.9, 0.0, 5.0, 1) for frame in range(FRAMES)]
    found = dict(figures(tally_of_scene(tmp_path, scene(seen(range(FRAMES), x_m=20.1), true))))
    assert found["objects_ap.0-20m"] == pytest.approx(1.0)
    assert "objects_ap.20-40m" not in found


def test_recall_by_time_to_impact_counts_objects_in_the_path(tmp_path):
    near = {"in_path": True, "time_to_impact_s": 1.5, "detected": True}
    found = dict(figures(tally_of_scene(tmp_path, scene([]), **near)))
    assert found["objects_recall.1-2s"] == 1.0
    assert "objects_recall.0-1s" not in found
    beside = dict(figures(tally_of_scene(tmp_path, scene([]), **near | {"in_path": False})))
    assert not [name for name in beside if name.startswith("objects_recall")]


def test_frames_without_truth_do_not_count(tmp_path):
    """Half of the frames have no message of true objects, so their detections are no false alarms."""
    path = write_scene(tmp_path, scene(seen(range(FRAMES))))
    unknown = pl.when(pl.col("frame") % 2 == 0).then("true_objects").alias("true_objects")
    pl.read_parquet(path).with_columns(unknown).write_parquet(path)
    found = dict(figures(tally_of_run(path)))
    assert (found["objects_ap"], found["tracks_mota"]) == pytest.approx((1.0, 1.0))


def tally_of_run(path):
    frames = load(source_of_runs([run_of(path)]))
    return tallies(frames, groups_of_runs(frames, ["all"]))[0]


def test_slices_have_the_figures_of_their_frames(tmp_path):
    path = write_scene(tmp_path, scene(seen(range(FRAMES // 2))))
    frames = load(source_of_runs([run_of(path)]))
    groups = groups_of_runs(frames, ["all"])
    halves = replace(groups, names=["first", "second"], of_frames=(frames.frame >= FRAMES // 2).astype(int))
    first, second = tallies(frames, halves)
    assert dict(figures(first))["objects_ap"] == pytest.approx(1.0)
    assert dict(figures(second))["objects_ap"] == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_the_mean_of_the_frames_contributions_is_the_figure(tmp_path, seed):
    run = run_of(write_scene(tmp_path, random_scene(seed)))
    whole = dict(figures(tally_of_run(run.path)))
    for parts in (1, 4, 100):
        values = frame_values(run, np.arange(run.frames), parts)
        assert {name: of.mean() for name, of in values.items()} == pytest.approx(whole)


def test_a_missed_object_is_seen_in_the_contribution_of_its_frame(tmp_path):
    run = run_of(write_scene(tmp_path, scene(seen(k for k in range(FRAMES) if k != 7))))
    values = frame_values(run, np.arange(FRAMES), 100)
    for name in ("objects_ap", "tracks_hota", "tracks_mota", "tracks_idf1"):
        assert np.argmin(values[name]) == 7, name


def test_compare_and_check_find_missed_objects(tmp_path, capsys):
    good = write_scene(tmp_path, scene(seen(range(120)), frames=120), "good")
    bad = write_scene(tmp_path, scene(seen(k for k in range(120) if k % 3), frames=120), "bad")
    assert outcome(compare, capsys, good, good)[0] == 0
    verdict = tmp_path / "verdict.json"
    code, text, _ = outcome(compare, capsys, good, bad, "--json", verdict)
    assert code == 1
    assert "objects AP" in text
    worse = json.loads(verdict.read_text())["metrics"]
    assert {worse[name]["mark"] for name in ("objects_ap", "objects_ap.vehicle", "tracks_hota", "tracks_mota")} == {
        "worse"
    }
    assert worse["objects_ap"]["place"]["frame"] % 3 == 0
    assert outcome(compare, capsys, bad, good)[0] == 0
    limits = tmp_path / "limits.toml"
    assert outcome(check, capsys, good, "--init", limits)[0] == 0
    assert outcome(check, capsys, good, "--criteria", limits)[0] == 0
    code, text, _ = outcome(check, capsys, bad, "--criteria", limits)
    assert code == 1
    assert "failed   objects_ap mean" in text


def test_a_criterion_describes_the_frames_of_its_filter(tmp_path, capsys):
    path = write_scene(tmp_path, scene(seen(range(FRAMES // 2))))
    limits = tmp_path / "limits.toml"
    line = 'metric = "objects_ap"\nstatistic = "mean"\nleast = 0.99\n'
    limits.write_text(f'[[criterion]]\n{line}filter = "frame < {FRAMES // 2}"\n')
    assert outcome(check, capsys, path, "--criteria", limits)[0] == 0
    limits.write_text(f"[[criterion]]\n{line}")
    assert outcome(check, capsys, path, "--criteria", limits)[0] == 1
    limits.write_text(f"[[criterion]]\n{line.replace('mean', 'p5')}")
    code, _, error = outcome(check, capsys, path, "--criteria", limits)
    assert code == 3
    assert "expected the statistic mean" in error


def test_tables_of_older_versions_have_no_such_figures(tmp_path, capsys):
    path = write_scene(tmp_path, scene(seen(range(FRAMES))))
    pl.read_parquet(path).drop("true_objects").write_parquet(path)
    code, text, _ = outcome(report, capsys, path, "--full")
    assert code == 0
    assert "Tracks" not in text
    assert outcome(compare, capsys, path, path)[0] == 0


def test_the_report_prints_the_tables(tmp_path, capsys):
    more = {"in_path": True, "time_to_impact_s": 2.5, "detected": True}
    path = write_scene(tmp_path, scene(seen(range(FRAMES))), **more)
    for options in (["--full"], ["--full", "--by", "frame < 20"], ["--by", "class"]):
        code, text, _ = outcome(report, capsys, path, *options)
        assert code == 0
        assert all(name in text for name in ("vehicle 0-20m", "HOTA", "2-3s", "AVE m/s")), options
