"""The results on the sample are those recorded, for each setting that chooses a method.

Other tests compare results with the truth, within its tolerance; this test detects smaller changes. After an intended
change raise ``RESULTS_VERSION``, so that batches replay their logs again, and record the results with
``pytest tests/chain/test_recorded.py --force-regen``; remove the earlier recording.
"""

import numpy as np
import polars as pl
import polars.selectors as cs

import roadperc_stream as rp
from roadperc_stream.batch.task import RESULTS_VERSION
from roadperc_stream.config import load_config
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.columns import TIME_COLUMNS
from tests.test_sample import SAMPLE

METHODS = {
    "defaults": [],
    "full-stereo": ["stereo.method=full", "stereo.block_px=7", "stereo.refine_px=0"],
    "lines": ["lanes.model=line", "lanes.use_odometry=false", "surface.model=spline"],
    "orb": ["odometry.features=orb", "odometry.matcher=flann"],
    "sift": ["odometry.features=sift", "lanes.canny_aperture=5"],
}
TOLERANCE = {"rtol": 1e-3, "atol": 1e-3}


def test_the_sample_gives_what_was_recorded(tmp_path, ndarrays_regression):
    measured = {}
    for method, settings in METHODS.items():
        out = tmp_path / f"{method}.mcap"
        rp.replay(SAMPLE, out, config=load_config(None, settings), start_s=1.0, max_frames=12)
        for table in ("metrics", "objects"):
            rows = pl.read_parquet(sidecar_path(out, table)).drop(TIME_COLUMNS, strict=False)
            measured[f"{table} columns"] = np.array(rows.columns)
            measured[f"{method} {table}"] = rows.select(cs.numeric() | cs.boolean()).cast(pl.Float64).to_numpy()
    ndarrays_regression.check(measured, basename=f"results_{RESULTS_VERSION}", default_tolerance=TOLERANCE)
