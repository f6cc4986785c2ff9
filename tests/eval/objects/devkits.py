"""Prints the figures of scenes by nuscenes-devkit and trackeval, as JSON; runs in their own Python, away from ours.

Standard input is a JSON list of scenes: for each class the true objects and the detections as lists of frame, x, y,
speed (null if unknown), track and, for detections, score.
"""

import json
import sys
from collections import defaultdict

import numpy as np
from nuscenes.eval.common.data_classes import EvalBoxes
from nuscenes.eval.common.utils import center_distance
from nuscenes.eval.detection.algo import accumulate, calc_ap, calc_tp
from nuscenes.eval.detection.data_classes import DetectionBox
from trackeval.metrics import CLEAR, HOTA, Identity

CLASS = "car"
LIMITS_M = (0.5, 1.0, 2.0, 4.0)
FARTHEST_M = 4.0
QUIET = {"THRESHOLD": 0.5, "PRINT_CONFIG": False}


def boxes(rows, frames):
    found = EvalBoxes()
    by_frame = defaultdict(list)
    for frame, x, y, speed, _, *score in rows:
        by_frame[frame].append(
            DetectionBox(
                sample_token=str(frame),
                translation=(x, y, 0.0),
                size=(1.0, 1.0, 1.0),
                rotation=(1.0, 0.0, 0.0, 0.0),
                velocity=(np.nan if speed is None else speed, 0.0),
                detection_name=CLASS,
                detection_score=score[0] if score else -1.0,
            )
        )
    for frame in range(frames):
        found.add_boxes(str(frame), by_frame[frame])
    return found


def detection(true, found, frames):
    data = [accumulate(boxes(true, frames), boxes(found, frames), CLASS, center_distance, limit) for limit in LIMITS_M]
    errors = [calc_tp(data[LIMITS_M.index(2.0)], 0.1, name) for name in ("trans_err", "vel_err")]
    return {"precision": [calc_ap(of, 0.1, 0.1) for of in data], "off_m": errors[0], "off_mps": errors[1]}


def tracking(true, found, frames):
    ids = [sorted({row[4] for row in rows}) for rows in (true, found)]
    data = {
        "gt_ids": [],
        "tracker_ids": [],
        "similarity_scores": [],
        "num_timesteps": frames,
        "num_gt_ids": len(ids[0]),
        "num_tracker_ids": len(ids[1]),
        "num_gt_dets": len(true),
        "num_tracker_dets": len(found),
    }
    for frame in range(frames):
        own, other = ([row for row in rows if row[0] == frame] for rows in (true, found))
        data["gt_ids"].append(np.array([ids[0].index(row[4]) for row in own], int))
        data["tracker_ids"].append(np.array([ids[1].index(row[4]) for row in other], int))
        places, others = (np.array([row[1:3] for row in rows], float).reshape(-1, 2) for rows in (own, other))
        apart = np.linalg.norm(places[:, None] - others[None], axis=2)
        data["similarity_scores"].append(np.maximum(0.0, 1.0 - apart / FARTHEST_M))
    hota, clear, identity = (kind.eval_sequence(data) for kind in (HOTA(), CLEAR(QUIET), Identity(QUIET)))
    of_hota = {name.lower(): float(np.mean(hota[name])) for name in ("HOTA", "DetA", "AssA")}
    return {**of_hota, "mota": float(clear["MOTA"]), "switched": int(clear["IDSW"]), "idf1": float(identity["IDF1"])}


def main():
    results = [
        {
            name: detection(*of, scene["frames"]) | tracking(*of, scene["frames"])
            for name, of in scene["classes"].items()
        }
        for scene in json.load(sys.stdin)
    ]
    json.dump(results, sys.stdout)


if __name__ == "__main__":
    sys.stdout, out = sys.stderr, sys.stdout
    sys.stdout = out
    main()
