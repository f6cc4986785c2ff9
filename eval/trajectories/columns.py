"""A run's estimated and true poses, from its metrics table."""

from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.core.geometry import Float
from roadperc_stream.errors import TableError

from ..collecting import collect
from ..runs import Run
from ..scan import rows_of
from ..segments import SEGMENT, segment
from .poses import RunPoses, pose_matrices

_POSE: Final = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
ESTIMATED_COLUMNS: Final = tuple(f"odom_{name}" for name in _POSE)
TRUE_COLUMNS: Final = tuple(f"true_{name}" for name in _POSE)
FARTHEST_M: Final = 1e9
_LENGTHS: Final = (1e-3, 1e3)
"""Of a quaternion: of any other not even the direction is sure."""


def read_poses(run: Run) -> RunPoses:
    """Read a run's poses; one with a value that is missing, not finite or no place on Earth is missing.

    Raises:
        TableError: the table cannot be read, or no frame has an estimated pose.
    """
    table = collect(rows_of(run).select(_columns(run)), run.source_name)
    if run.next_part and not run.frames:
        raise TableError(run.why_empty)
    lost = (table["odometry_status"] == "lost").fill_null(value=False).to_numpy()
    estimated, true = (table.select(names).to_numpy() for names in (ESTIMATED_COLUMNS, TRUE_COLUMNS))
    has_estimate, has_truth = _known(estimated) & ~lost, _known(true)
    if not has_estimate.any():
        raise TableError(
            f"{run.source_name}: no frame has an estimated pose (odom_x_m to odom_qw); was odometry replayed?"
        )
    used = has_estimate & has_truth if has_truth.any() else has_estimate
    turned = table["turn_deg"].is_not_null()
    return RunPoses(
        name=run.name,
        source=run.source_name,
        frames=run.frames,
        lost=int(lost.sum()),
        estimated_frames=int(has_estimate.sum()),
        true_frames=int(has_truth.sum()),
        steps=int(turned.sum()),
        without_scale=int((turned & table["step_m"].is_null()).sum()),
        stamps_ns=table["stamp_ns"].to_numpy()[used],
        estimated=pose_matrices(estimated[used]),
        true=pose_matrices(true[used]) if has_truth.any() else None,
        segments=table[SEGMENT].to_numpy()[used],
    )


def _columns(run: Run) -> list[pl.Expr]:
    """What is read of a table, a column that it lacks as nulls."""
    kinds = {"odometry_status": pl.String, "stamp_ns": pl.Int64}
    numbers = dict.fromkeys(("step_m", "turn_deg", *ESTIMATED_COLUMNS, *TRUE_COLUMNS), pl.Float64)
    return [
        segment(run.columns),
        *(
            pl.col(name).cast(kind) if name in run.columns else pl.lit(None, kind).alias(name)
            for name, kind in (kinds | numbers).items()
        ),
    ]


def _known(rows: Float) -> NDArray[np.bool_]:
    """(N,) which of (N, 7) rows are a pose."""
    with np.errstate(over="ignore"):  # what is too long for a number is too long
        length = np.linalg.norm(rows[:, 3:], axis=1)
    shortest, longest = _LENGTHS
    known: NDArray[np.bool_] = (
        (np.abs(rows[:, :3]) <= FARTHEST_M).all(axis=1) & (shortest <= length) & (length <= longest)
    )
    return known
