"""The Python API: replay a log, iterate over its frames, run the chain on arrays, read metrics.

Lengths are in metres, stamps in nanoseconds, pixels count from 0 at the centre of the first one. ``a_T_b`` is a (4, 4)
matrix that maps coordinates in frame b to frame a: ego is x forward, y left, z up, cameras are x right, y down,
z forward.
"""

from __future__ import annotations  # help() shows the name ArrayLike instead of its long definition

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from roadperc_stream.chain.own_stage import OwnStage, own_stages
from roadperc_stream.chain.prepare import prepare
from roadperc_stream.chain.step import State, step
from roadperc_stream.config import ReplayConfig, load_config, validated
from roadperc_stream.errors import WITHOUT_CALIBRATION, ConfigError, RoadpercError, TableError
from roadperc_stream.formats.images import encode_png
from roadperc_stream.geometry import Camera, mounting
from roadperc_stream.input import ReplaySource, arrays
from roadperc_stream.input.rectified import rectified_frame
from roadperc_stream.loop import replay as _replay
from roadperc_stream.metrics import frame_metrics
from roadperc_stream.model import Detection, Frame, FrameResult, Image, Truth
from roadperc_stream.model.tag_tables import table_for_version
from roadperc_stream.output.drawing.on_request import perceived
from roadperc_stream.output.drawing.overlay import draw_results
from roadperc_stream.output.input_log import write_input_log
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import ReplaySummary
from roadperc_stream.resume.opening import ReplayOptions, open_log
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.system.files import require_free
from roadperc_stream.system.threads import one_thread, usable_cores
from roadperc_stream.system.time import TimeRange

if TYPE_CHECKING:
    import polars as pl

_ARGUMENTS: Final = {
    "--force": "force=True",
    "--resume or --force": "resume=True or force=True",
    WITHOUT_CALIBRATION: 'config={"calibration": {"fov_deg": DEGREES}}',
}
"""Arguments of ``replay`` for the options that errors name."""
Config = ReplayConfig | Mapping[str, Any] | str | Path | None
"""A configuration, a nested mapping such as ``{"lanes": {"hold_s": 0.8}}``, a TOML file, or None for the defaults."""
Source = str | Path | Sequence[str | Path]
"""A log, or the files of a log."""


def replay(
    src: Source,
    dst: str | Path,
    *,
    config: Config = None,
    topics: Mapping[str, str] | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    max_frames: int | None = None,
    results_only: bool = False,
    force: bool = False,
    recover: bool = False,
    strict: bool = False,
    continued: str | Path | None = None,
    warm_up_s: float = 0.0,
    checkpoint_every_s: float | None = None,
    resume: bool = False,
    threads: int | None = None,
) -> ReplaySummary:
    """Replay a log through the chain, as ``roadperc-replay`` does.

    Args:
        src: the log to read, or its files.
        dst: the log to write; the tables are ``dst`` with the suffixes ``.metrics.parquet`` and ``.objects.parquet``.
        config: the chain's configuration.
        topics: topic by role, for topics with other names, such as ``{"image": "/front/rgb"}``.
        start_s: start of the replay in seconds after the log's first message.
        end_s: end of the replay in seconds after the log's first message.
        max_frames: largest number of frames.
        results_only: write only results to ``dst``, without the input's messages.
        force: replace an existing result, but never an input log; ignore a checkpoint of another replay.
        recover: replay the readable part of a damaged log; frames after a loss have a reason.
        strict: stop with an error at the first unusable message, instead of skipping it.
        continued: the earlier result to continue, with the same configuration.
        warm_up_s: seconds of log before ``start_s`` that build the state and are not written.
        checkpoint_every_s: seconds of log between two checkpoints; None for no checkpoints.
        resume: continue from the latest checkpoint, if any.
        threads: number of threads; None for one per core. The output does not depend on it, except for timing columns.

    Returns:
        Frames, dropped messages, notes, warnings of damage, and the reasons of all frames.

    Raises:
        RoadpercError: the input cannot be read or replayed, or the output cannot be written; partial files are removed.
            After a failure of a stage of your own, ``__cause__`` is its exception.
    """
    cfg, own = own_stages(_config(config))
    before = None if continued is None else Path(continued)
    with _arguments_in_errors():
        return _replay(
            ReplaySource(_paths(src), dict(topics or {}), TimeRange(start_s, end_s, max_frames), recover, strict),
            ReplayTarget(Path(dst), results_only=results_only, force=force),
            cfg,
            ReplayOptions(before, warm_up_s, checkpoint_every_s, resume, _threads(threads), own),
        )


@contextmanager
def _arguments_in_errors() -> Iterator[None]:
    """Errors name ``force=True`` instead of the command's option ``--force``."""
    try:
        yield
    except RoadpercError as error:
        error.option = _ARGUMENTS.get(error.option, error.option)
        raise


@dataclass(frozen=True)
class LogFrame:
    """A frame of a log: input of the chain, truth, result of the chain, and row of metrics."""

    input: Frame
    truth: Truth
    result: FrameResult
    metrics: FrameMetrics

    def __str__(self) -> str:
        """The number of the frame and its result, in one line."""
        return f"frame {self.metrics.frame}: {self.result}"

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        return encode_png(draw(self)[..., ::-1])


def draw(frame: Frame | LogFrame, result: FrameResult | None = None) -> Image:
    """The results of a frame drawn into its camera image; without an image into its depth, else over black.

    Args:
        frame: a frame of ``rp.frames``, or a frame from ``Chain.frame``.
        result: its result, which a frame of ``rp.frames`` already has.

    Returns:
        (H, W, 3) uint8 in the order red, green, blue, as matplotlib and Pillow expect.

    Raises:
        TypeError: a frame from ``Chain.frame`` has no result.
    """
    if isinstance(frame, LogFrame):
        return draw(frame.input, result or frame.result)
    if result is None:
        raise TypeError("draw: expected a result; pass rp.draw(frame, chain.step(frame))")
    picture = draw_results(perceived(rectified_frame(frame), result), frame.camera.width)
    return np.ascontiguousarray(picture[..., ::-1])


def write_log(path: str | Path, frames: Iterable[Frame | LogFrame], *, force: bool = False) -> int:
    """Write frames as a log that ``replay`` and the commands read; returns their number.

    Calibration, mounting, images (lossless), depth, tags and detections are written, of a ``LogFrame`` also its truth.
    Lidar points and instance masks are left out.

    Args:
        path: the log to write, ``NAME.mcap``.
        frames: frames from ``Chain.frame`` or ``rp.frames``, in the order of their stamps.
        force: replace an existing file.

    Raises:
        RoadpercError: the log exists or cannot be written, or there are no frames.
    """
    target = Path(path)
    with _arguments_in_errors():
        require_free(target, force=force, suffix=".mcap")
        pairs = ((f.input, f.truth) if isinstance(f, LogFrame) else (f, Truth()) for f in frames)
        return write_input_log(target, pairs)


def frames(
    log: Source,
    *,
    config: Config = None,
    topics: Mapping[str, str] | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    max_frames: int | None = None,
    recover: bool = False,
) -> Iterator[LogFrame]:
    """Run the chain over a log and yield its frames with their results, in order.

    No file is written, and one frame is in memory at a time. Arguments as in ``replay``.

    Raises:
        RoadpercError: the log cannot be read or replayed.
    """
    cfg, own = own_stages(_config(config))
    source = ReplaySource(_paths(log), topics or {}, TimeRange(start_s, end_s, max_frames), recover)
    with _arguments_in_errors():
        opened = open_log(source, cfg)
        cfg = opened.input.cfg
        chain, earlier = State(), None
        for sample in opened.input.samples():
            with one_thread():  # the same bits as in a replay, with any settings of the caller
                frame = prepare(cfg, sample.frame, own=own)
                chain, result = step(cfg, chain, frame, own=own)
                row = frame_metrics(cfg, opened.input.log_id, sample, result, earlier)
            earlier = sample.as_earlier
            if sample.is_written:
                yield LogFrame(frame, sample.truth, result, row)


class Chain:
    """The perception chain for your own arrays: call ``step`` once per frame, in the order of time.

    The object keeps the chain's state between frames; ``reset`` clears it.
    """

    def __init__(
        self,
        camera: Camera,
        config: Config = None,
        *,
        ego_T_camera: ArrayLike | None = None,
        right_camera: Camera | None = None,
        tag_table: str = "",
        stages: Mapping[str, Callable[..., Any]] | None = None,
    ) -> None:
        """Set up the chain.

        Args:
            camera: the camera of image, depth, tags and detections.
            config: the chain's configuration.
            ego_T_camera: (4, 4) mounting, such as ``rp.mounting(x=1.2, z=1.5, pitch=2)``; None for a level camera at
                ``surface.assumed_height_m``.
            right_camera: right camera of a rectified pair whose left camera is ``camera``; ``baseline_m`` is positive.
            tag_table: CARLA version of the numbers in ``tags``, such as ``"0.9.15"``; empty for the configuration's
                ``tag_table``.
            stages: stages of your own by name, such as ``{"lanes": MyLanes}``: classes or functions with the signatures
                in ``roadperc_stream.chain.protocols``. They override ``implementation`` in the configuration.

        Raises:
            TypeError: a camera is not a Camera.
            ValueError: a camera or the mounting has invalid numbers, or the camera does not look ahead.
            ConfigError: the configuration is invalid, the tag table is unknown, or a stage cannot be used.
        """
        self._cfg, own = own_stages(_config(config))
        self._own = {**own, **{stage: OwnStage.of(stage, code) for stage, code in (stages or {}).items()}}
        self._camera = arrays.checked_camera("camera", camera)
        self._right_camera = None if right_camera is None else arrays.checked_camera("right_camera", right_camera)
        self._mounted = ego_T_camera is not None
        level = mounting(z=self._cfg.surface.assumed_height_m)
        self._ego_T_camera = level if ego_T_camera is None else arrays.checked_mounting(ego_T_camera)
        version = tag_table or self._cfg.tag_table
        self._table = None if version == "auto" else table_for_version(version)
        self.reset()

    def reset(self) -> None:
        """Clear the state."""
        self._state = State()
        self.segment = 0
        """Number of times that a stamp cleared the state since then."""

    def frame(
        self,
        stamp_ns: int,
        *,
        image: ArrayLike | None = None,
        depth_m: ArrayLike | None = None,
        tags: ArrayLike | None = None,
        detections: Sequence[Detection] | None = None,
        right_image: ArrayLike | None = None,
    ) -> Frame:
        """A frame of your own arrays, for ``step``, ``rp.draw`` and ``rp.write_log``; any input may be missing.

        Args:
            stamp_ns: the frame's time, of any integer type.
            image: (H, W, 3) uint8 in OpenCV's order blue, green, red, or (H, W) grey.
            depth_m: (H, W) floating-point metres along the camera's z axis, NaN unknown.
            tags: (H, W) class of each pixel, by ``tag_table``: any integer type, 0 to 255.
            detections: in pixels, such as ``Detection("car", Box(150, 100, 180, 140), score=0.9)``.
            right_image: as ``image``, of the right camera.

        Raises:
            TypeError: the stamp or a detection has another type.
            ValueError: an array has another shape or type, or a detection's box is invalid.
            ConfigError: tags were given without a tag table.
        """
        camera, right_camera = self._camera, self._right_camera or self._camera
        return Frame.of(
            arrays.checked_stamp_ns(stamp_ns),
            camera,
            self._ego_T_camera,
            mounted=self._mounted,
            image=None if image is None else arrays.camera_image("image", image, camera),
            right=None if right_image is None else arrays.camera_image("right_image", right_image, right_camera),
            right_camera=self._right_camera,
            depth_image=None if depth_m is None else arrays.depth_image(depth_m, camera),
            segmentation=None if tags is None else arrays.tag_image(tags, camera, self._table),
            detections=None if detections is None else arrays.checked_detections(detections),
        )

    def step(
        self,
        stamp_ns: int | Frame,
        *,
        image: ArrayLike | None = None,
        depth_m: ArrayLike | None = None,
        tags: ArrayLike | None = None,
        detections: Sequence[Detection] | None = None,
        right_image: ArrayLike | None = None,
    ) -> FrameResult:
        """Run the chain on one frame; any input may be missing.

        Args:
            stamp_ns: the frame's time, or the whole frame from ``frame``. A stamp before the last frame's, or more than
                an hour after it, begins a new ``segment``: it clears the state, and ``problems`` of the result has the
                reason.
            image: the arrays as for ``frame``.
            depth_m: see ``frame``.
            tags: see ``frame``.
            detections: see ``frame``.
            right_image: see ``frame``.

        Returns:
            The output of each stage, or ``Absent`` with a reason.

        Raises:
            TypeError: as ``frame``, or a frame and arrays are both given.
            ValueError: as ``frame``, or the stamp is the last frame's.
            ConfigError: as ``frame``.
        """
        given = (image, depth_m, tags, detections, right_image)
        if isinstance(stamp_ns, Frame):
            if any(value is not None for value in given):
                raise TypeError("step: pass a frame or arrays, not both")
            frame = stamp_ns
        else:
            frame = self.frame(
                stamp_ns, image=image, depth_m=depth_m, tags=tags, detections=detections, right_image=right_image
            )
        if frame.stamp_ns == self._state.stamp_ns:
            hint = "pass a later one, or call reset() before"
            raise ValueError(f"stamp_ns: {frame.stamp_ns} is also the last frame's; {hint}")
        with one_thread():
            prepared = prepare(self._cfg, rectified_frame(frame), own=self._own)
            self._state, result = step(self._cfg, self._state, prepared, own=self._own)
        self.segment += any(problem.source == "time" for problem in result.problems)
        return result


def read_metrics(run: str | Path | Sequence[str | Path]) -> pl.DataFrame:
    """The metrics of a run as a polars frame with a row per frame.

    Args:
        run: a log with results and its table, or the table. For continued replays, a list in their order; the later run
            replaces frames of the earlier one.

    Raises:
        TableError: the table does not exist or cannot be read.
    """
    import polars as pl  # noqa: PLC0415 - only this function needs it

    if isinstance(run, str | Path):
        return _metrics_table(Path(run))
    tables = [_metrics_table(Path(path)) for path in run]
    if not tables:
        raise TableError("read_metrics: expected at least one run")
    columns = ("frame",)
    return pl.concat(tables, how="diagonal").unique(columns, keep="last", maintain_order=True).sort(columns)


def _metrics_table(path: Path) -> pl.DataFrame:
    import polars as pl  # noqa: PLC0415 - as above

    from roadperc_stream.output.tables import sidecar_path  # noqa: PLC0415

    table = sidecar_path(path, "metrics") if path.suffix == ".mcap" else path
    if table.is_dir():
        raise TableError(f"{table}: expected a metrics table, found a folder")
    try:
        return pl.read_parquet(table, glob=False)
    except FileNotFoundError as error:
        raise TableError(f"{table}: no such metrics table") from error
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise TableError(f"{table}: not a readable metrics table: {error}") from error


def _paths(source: Source) -> list[Path]:
    return [Path(source)] if isinstance(source, str | Path) else [Path(path) for path in source]


def _config(config: Config) -> ReplayConfig:
    if isinstance(config, ReplayConfig):
        return config
    if isinstance(config, Mapping):
        return validated(config, "config: ")
    return load_config(config)


def _threads(threads: int | None) -> int:
    if threads is not None and (isinstance(threads, bool) or not isinstance(threads, int)):
        raise TypeError(f"threads: {threads!r}, expected a whole number of 1 or more")
    if threads is not None and threads < 1:
        raise ConfigError(f"threads: {threads}, expected 1 or more")
    return threads or usable_cores()
