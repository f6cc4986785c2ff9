"""Write the segmentation and the detections that networks compute from a log's images."""

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from roadperc_stream import __version__, log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ChannelError, DecodeError, NoFrameError
from roadperc_stream.formats.images import encode_indices
from roadperc_stream.input.assemble import ego_T_camera_of
from roadperc_stream.input.calibrations import calibration_role
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.replaced import first_latched, with_recorded
from roadperc_stream.input.roles import assignment_of_log
from roadperc_stream.input.stream import Problems, RoleAssignment, decoded_messages
from roadperc_stream.input.topics import fits
from roadperc_stream.log import Channel, LogSummary, LogWriter, Message, MessageCopy, Metadata
from roadperc_stream.model import CameraImage
from roadperc_stream.output import encoding
from roadperc_stream.output.input_log import channel_of
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.schemas import record
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.files import require_free, scratch_folder
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import number, print_line
from roadperc_stream.system.threads import in_order, one_thread, usable_cores

from .conversion import recording_of, write
from .layouts.dataset import ConvertOptions
from .log_copy import copy_records
from .networks.description import read_network
from .networks.frames import Inferred, Pair, RawResult, load
from .networks.plausibility import RoadCheck
from .networks.semantic import HorizonEstimate
from .video_log import videos_of

_IMAGE_ROLES: Final = ("image", "left")


@dataclass(frozen=True)
class InferOptions:
    """How to infer: the topics by role of a log, or the options of a recording that is converted first."""

    topics: Mapping[str, str] = field(default_factory=dict)
    recording: ConvertOptions = field(default_factory=ConvertOptions)
    threads: int | None = None
    """None for one per core."""
    force: bool = False
    quiet: bool = False


@dataclass(frozen=True)
class InferenceJob:
    """A log and what is written into its copy.

    ``image`` is the role of the images, ``replaced`` are the topics of channels that are left out.
    """

    summary: LogSummary
    roles: RoleAssignment
    image: str
    replaced: frozenset[str]
    camera_height_m: float
    pair: Pair
    cfg: ReplayConfig
    """What the user, or an earlier replay, says about the log."""

    @property
    def channels(self) -> dict[str, Channel]:
        """The new channels, by role."""
        table = None if self.pair.segmentation is None else self.pair.segmentation.keys.table
        return {role: channel_of(role, table) for role in self.pair.by_role}


def infer(source: Path, out: Path, networks: Sequence[Path], cfg: ReplayConfig, options: InferOptions) -> None:
    """Write ``out`` from a log, a ROS bag, or anything that ``roadperc-convert`` reads.

    ``networks`` are their descriptions; ``cfg`` says what a log does not.

    Raises:
        RoadpercError: a network, the input or the output cannot be used.
    """
    require_free(out, force=options.force, suffix=".mcap", source=source)
    pair = load([read_network(path) for path in networks])
    with one_thread(), _as_log(source, out, options.recording) as summary:
        job = _job(summary, pair, options, with_recorded(cfg, summary.attachments, source))
        started = time.monotonic()
        frames, warnings = _write(job, out, options)
    with optional_output(sys.stderr):
        for text in warnings:
            print_line(f"warning: {text}", sys.stderr)
    if not options.quiet:
        used = job.pair.by_role.items()
        made = "; ".join(f"{role} by {one.network.keys.file} ({one.session.runtime})" for role, one in used)
        rate = frames / (time.monotonic() - started)
        print_line(f"{number(frames, 'frame')}, {rate:.1f} frames per second, {made}: {out}")


@contextmanager
def _as_log(source: Path, out: Path, options: ConvertOptions) -> Iterator[LogSummary]:
    """Yield the log, or a temporary one beside the output that is converted from other input."""
    summary = log.summarise(log.received([source])) if log.is_log(source) else None
    if summary is not None and not _has_only_video(summary):
        yield summary
        return
    with scratch_folder(out) as folder:
        converted = folder / f"{source.name or out.stem}.mcap"
        write(recording_of(source, options), converted, force=False, quiet=True)
        yield log.summarise(converted)


def _has_only_video(summary: LogSummary) -> bool:
    """Whether the images of a log are videos."""
    videos = videos_of(summary)
    has_images = any(fits(ROLES["image"], channel) for channel in summary.channels if channel not in videos)
    return not has_images and bool(videos)


def _job(summary: LogSummary, pair: Pair, options: InferOptions, cfg: ReplayConfig) -> InferenceJob:
    """Return the job of a log.

    Raises:
        ChannelError: there are no images, or existing results may not be replaced.
    """
    roles = assignment_of_log(summary, options.topics)
    image = next((role for role in _IMAGE_ROLES if role in roles.topics), None)
    if image is None:
        raise ChannelError(f"{summary.path}: no channel for role image; choose one with --topic image=/TOPIC")
    there = {role: roles.topics[role] for role in pair.by_role if role in roles.topics}
    if there and not options.force:
        listed = ", ".join(f"{role} on {topic}" for role, topic in there.items())
        raise ChannelError(f"{summary.path}: has {listed}; pass --force to replace it")
    height_m = options.recording.height_m or _camera_height_m(summary, roles, image, cfg)
    return InferenceJob(summary, roles, image, frozenset(there.values()), height_m, pair, cfg)


def _camera_height_m(summary: LogSummary, roles: RoleAssignment, image: str, cfg: ReplayConfig) -> float:
    """Height of the camera by its mounting, else ``surface.assumed_height_m``."""
    latched = first_latched(summary, roles, cfg)
    camera = latched.cameras.get(calibration_role(image, latched.cameras))
    known = None if camera is None else ego_T_camera_of(latched.tree, camera)
    return cfg.surface.assumed_height_m if known is None or known[2, 3] <= 0 else float(known[2, 3])


def _write(job: InferenceJob, out: Path, options: InferOptions) -> tuple[int, list[str]]:
    """Write the copy with the new channels; return the number of frames, and warnings."""
    summary, channels, problems, check, frames = job.summary, job.channels, Problems(), RoadCheck(), 0
    kept = [channel for channel in summary.channels if not is_result(channel) and channel.topic not in job.replaced]
    topic = job.roles.topics[job.image]
    expected = sum(summary.counts.get(c.source_id, 0) for c in summary.channels if c.topic == topic)
    threads = options.threads or usable_cores()
    with LogWriter(out, summary.profile) as target, frame_progress("inferring", not options.quiet) as progress:
        copy = MessageCopy(target, kept, log.pieces(summary, kept, None, None))
        for channel in channels.values():
            target.register(channel)
        for item, result in _results(job, problems, threads):
            copy.through(item.log_time_ns)
            for role, data in _encoded(job, item, result):
                target.write(Message(channels[role], item.log_time_ns, item.log_time_ns, frames, data))
            if job.pair.segmentation is not None and result.tags is not None:
                check.add(job.pair.segmentation.keys.table, result.tags)
            frames += 1
            progress(frames, expected)
        if not frames:
            raise NoFrameError(f"{summary.path}: no image on {topic} can be read; {'; '.join(problems.first.values())}")
        copy.rest()
        _describe(job, target)
        require_free(out, force=options.force, suffix=".mcap")  # another program may have written it
    name = "" if job.pair.segmentation is None else job.pair.segmentation.network.keys.file
    unreadable = [f"{number(count, 'image')} could not be read, skipped" for count in problems.counts.values()]
    return frames, [*unreadable, *problems.first.values(), *check.warnings(name)]


def _results(job: InferenceJob, problems: Problems, threads: int) -> Iterator[tuple[Stamped, Inferred]]:
    """Yield images and their results in order; several images are computed at a time."""
    topic, horizon = job.roles.topics[job.image], HorizonEstimate()

    def raw_of(item: Stamped) -> tuple[Stamped, RawResult | DecodeError]:
        assert isinstance(item.payload, CameraImage)
        try:
            return item, job.pair.raw(item.payload.decode_bgr())
        except DecodeError as error:
            return item, error

    for item, raw in in_order(raw_of, _images(job, problems), threads):
        if isinstance(raw, DecodeError):
            problems.add(topic, item.log_time_ns, raw)
        else:
            horizon, result = job.pair.results(raw, horizon, job.camera_height_m)
            yield item, result


def _images(job: InferenceJob, problems: Problems) -> Iterator[Stamped]:
    topics = {job.image: job.roles.topics[job.image]}
    messages = log.read(job.summary, topics=topics.values())
    return decoded_messages(messages, replace(job.roles, topics=topics), problems=problems)


def _encoded(job: InferenceJob, item: Stamped, result: Inferred) -> Iterator[tuple[str, bytes]]:
    """Yield role and message of an image's results."""
    assert isinstance(item.payload, CameraImage)
    frame_id = item.payload.frame_id
    if result.tags is not None and job.pair.segmentation is not None:
        png = encode_indices(result.tags, job.pair.segmentation.keys.table.colours)
        yield "segmentation", encoding.encode_image(item.stamp_ns, frame_id, "png", png)
    if result.detections is not None:
        yield "detections", encoding.encode_detections(item.stamp_ns, frame_id, result.detections)


def _describe(job: InferenceJob, target: LogWriter) -> None:
    """Copy attachments and metadata, and record the networks."""
    copy_records(job.summary, target, job.cfg, without=record.NETWORKS_RECORD)
    before = (item.values for item in job.summary.metadata if item.name == record.NETWORKS_RECORD)
    values = {key: value for pairs in before for key, value in pairs} | {record.VERSION_KEY: __version__}
    for role, loaded in job.pair.by_role.items():
        values |= {
            f"{role}.network": loaded.network.model_path.name,
            f"{role}.sha256": loaded.network.sha256,
            f"{role}.runtime": loaded.session.runtime,
            f"{role}.settings": loaded.network.settings,
        }
    if job.pair.segmentation is not None:
        values["segmentation.camera_height_m"] = f"{job.camera_height_m:g}"
    target.describe(Metadata(record.NETWORKS_RECORD, tuple(sorted(values.items()))))
