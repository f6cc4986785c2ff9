"""The metrics of a frame and of each detection: pure functions of results and truth.

An error is estimate minus truth. A column is None if it could not be measured. docs/metrics.md has the formulas.
"""

from roadperc_stream.config import ReplayConfig
from roadperc_stream.metrics.lanes import lane_benchmarks, lane_columns, lane_errors, true_lane_columns
from roadperc_stream.metrics.objects import object_columns, object_errors, object_metrics, true_impact, true_objects
from roadperc_stream.metrics.odometry import odometry_columns, odometry_errors, true_pose_columns
from roadperc_stream.metrics.stereo import stereo_columns, stereo_errors_of
from roadperc_stream.metrics.surface import surface_columns, surface_errors
from roadperc_stream.model import EarlierTruth, FrameResult, Sample
from roadperc_stream.model.sample import frame_reasons
from roadperc_stream.schemas.columns import FrameKey, FrameMetrics, InputColumns, row_of

__all__ = ["frame_metrics", "object_metrics"]


def frame_metrics(
    cfg: ReplayConfig, log_id: str, sample: Sample, result: FrameResult, previous: EarlierTruth | None = None
) -> FrameMetrics:
    """The row of one frame, with errors if the log has truth; ``previous`` is the truth of the previous frame."""
    frame, truth, reasons = sample.frame, sample.truth, frame_reasons(sample, result)
    return row_of(
        FrameMetrics,
        FrameKey(log_id, sample.index, result.stamp_ns),
        surface_columns(result),
        lane_columns(result.lanes),
        object_columns(result.objects),
        stereo_columns(result.stereo),
        odometry_columns(result.odometry),
        surface_errors(cfg, result, sample),
        lane_errors(result.lanes, truth.lanes),
        true_lane_columns(result.lanes, truth.lanes),
        lane_benchmarks(result.lanes, truth.lanes, frame.camera, frame.ego_T_camera),
        object_errors(result.objects, truth.objects),
        true_impact(result.objects, truth.objects),
        true_objects(truth.objects),
        stereo_errors_of(result.stereo, sample),
        odometry_errors(result.odometry, sample, previous),
        true_pose_columns(truth),
        InputColumns(
            segment=sample.segment,
            sync_skew_ms=None if sample.skew_ns is None else sample.skew_ns / 1e6,
            missing=sample.missing,
            reasons=reasons,
            reason_codes=tuple(f"{reason.source}.{reason.code}" for reason in reasons),
        ),
    )
