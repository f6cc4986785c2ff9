"""The pictures of a log's frames: overlays, debug pictures, and images of the input."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Final

from roadperc_stream import log
from roadperc_stream.errors import ChannelError, LogError
from roadperc_stream.input.decoding import context_of_channel, decode, schemas_of_kind
from roadperc_stream.input.earlier_replay import is_result, is_result_of
from roadperc_stream.input.roles import assignment_of_log
from roadperc_stream.input.stream import Problems
from roadperc_stream.log import Channel, LogSummary, Message
from roadperc_stream.model import CameraImage, DepthImage, Image
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14
from roadperc_stream.output.drawing.on_request import depth_picture
from roadperc_stream.output.drawing.overlay import PerceivedFrame, draw_frame
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.schemas.roles import Kind
from roadperc_stream.schemas.topics import METRICS_TOPIC, ON_REQUEST, OVERLAY_TOPIC, STEREO_DEPTH_TOPIC
from roadperc_stream.system.text import listed
from roadperc_stream.system.time import ns_to_seconds
from roadperc_stream.view.frame_times import Stop
from roadperc_stream.view.result_frames import LATENESS_NS, content_of, read_frames, read_rows, row_of

Shot = Callable[[], Image | None]
"""Decodes or draws the (H, W, 3) picture of a frame; None if it cannot be read."""
_SCHEMAS: Final = (*schemas_of_kind("image"), *schemas_of_kind("depth"))


def picture_of(source: log.AnyLog, stop: Stop, topic: str = OVERLAY_TOPIC) -> Image:
    """(H, W, 3) picture of a frame on a topic; the overlay is drawn if the log has none.

    A topic of the input gives the picture whose stamp is nearest to the frame's. Depth is blue far and red near.

    Raises:
        LogError: the log has no such topic, or no picture of this frame.
    """
    summary, problems = log.summarise(source), Problems()
    channels = picture_channels(summary)
    channel = channels.get(topic)
    if channel is not None:
        picture = _nearest(summary, channel, stop, problems)
    elif topic == OVERLAY_TOPIC:
        picture = _drawn(summary, stop, problems)
    else:
        expected = f"expected {OVERLAY_TOPIC} or one of {listed(sorted(channels))}"
        raise LogError(f"{source}: no pictures on {topic}; {expected}")
    if picture is None:
        # the log may be a temporary replay, so the topic is named instead
        why = "".join(f"; {text}" for text in problems.first.values())
        where = "" if channel is None else _elsewhere(summary, channel, stop)
        raise LogError(f"{topic}: no picture of frame {stop.frame}{where or '; it has no camera image'}{why}")
    return picture


def picture_channels(summary: LogSummary) -> dict[str, Channel]:
    """The channels with pictures by topic; of several of one topic the first."""
    there = [channel for channel in summary.channels if summary.counts.get(channel.source_id)]
    return {c.topic: c for c in reversed(there) if (c.schema_name, c.message_encoding) in _SCHEMAS}


def _drawn(summary: LogSummary, stop: Stop, problems: Problems) -> Image | None:
    first_ns = next(row.stamp_ns for _, row in read_rows(summary, problems))
    for lateness_ns in LATENESS_NS:
        span_ns = max(stop.log_time_ns - lateness_ns, 0), stop.log_time_ns + 1
        for row, frame in read_frames(summary, problems, span_ns):
            if row.stamp_ns == stop.stamp_ns and frame is not None:
                return _overlay(replace(row, frame=stop.frame), frame, first_ns)
    return None


def _nearest(summary: LogSummary, channel: Channel, stop: Stop, problems: Problems) -> Image | None:
    """The picture of the frame's own stamp, among those of its log time; of an input also the nearest stamp."""
    kind: Kind = "depth" if channel.topic in {STEREO_DEPTH_TOPIC, *_depth_topics(summary)} else "image"
    for lateness_ns in LATENESS_NS:
        span = {"start_ns": max(stop.log_time_ns - lateness_ns, 0), "end_ns": stop.log_time_ns + lateness_ns + 1}
        read = [message for message in log.read(summary, topics=(channel.topic,), **span) if message.channel == channel]
        found = [one for message in read if (one := _picture(message, kind, problems)) is not None]
        exact = [picture for stamp_ns, picture in found if stamp_ns == stop.stamp_ns]
        if exact:
            return exact[0]()
    nearest = min(found, key=lambda one: abs(one[0] - stop.stamp_ns), default=None)
    return None if nearest is None or is_result(channel) else nearest[1]()


def _picture(message: Message, kind: Kind, problems: Problems) -> tuple[int, Shot] | None:
    """Stamp and picture of a message; None if it cannot be read."""
    channel, time_ns = message.channel, message.log_time_ns
    context = replace(context_of_channel(channel, "auto"), tag_table=CARLA_BEFORE_0_9_14)
    form = channel.schema_name, channel.message_encoding, message.data, time_ns, context
    decoded = content_of(partial(decode, kind, *form), channel.topic, time_ns, problems)
    if decoded is None:
        return None
    return decoded.stamp_ns, partial(content_of, partial(_pixels, decoded.payload), channel.topic, time_ns, problems)


def _pixels(payload: object) -> Image:
    if isinstance(payload, DepthImage):
        return depth_picture(payload.depth_m)
    assert isinstance(payload, CameraImage)
    return payload.bgr


def _depth_topics(summary: LogSummary) -> set[str]:
    try:
        roles = assignment_of_log(summary, {})
    except ChannelError:  # the roles of the input are ambiguous
        return set()
    return {topic for topic in roles.topics.values() if any(role.kind == "depth" for role in roles.roles_of(topic))}


def _elsewhere(summary: LogSummary, channel: Channel, stop: Stop) -> str:
    """The nearest frame with a picture of a result."""
    times_ns = [message.log_time_ns for message in log.read(summary, topics=(channel.topic,))]
    rows = {log_time_ns: row.frame for log_time_ns, row in read_rows(summary, Problems())}
    frames = [rows[time_ns] for time_ns in times_ns if time_ns in rows]
    nearest = min(frames, key=lambda frame: abs(frame - stop.frame), default=None)
    return "" if nearest is None else f"; the nearest frame with one is {nearest}"


def shots(summary: LogSummary, topic: str, problems: Problems, width_px: int) -> Iterator[Shot]:
    """The picture of every frame on a topic of ``ON_REQUEST``, in order; overlays are drawn if the log has none.

    Drawn overlays have ``width_px`` columns at most.

    Raises:
        LogError: the log has no such pictures.
    """
    channel = picture_channels(summary).get(topic)
    if channel is not None and is_result_of(channel, topic):
        yield from _written(summary, topic, problems)
    elif topic == OVERLAY_TOPIC:
        first_ns: int | None = None
        for row, frame in read_frames(summary, problems):
            first_ns = row.stamp_ns if first_ns is None else first_ns
            yield _no_picture if frame is None else partial(_overlay, row, frame, first_ns, width_px)
    else:
        option = f"--{ON_REQUEST[topic]}" if topic in ON_REQUEST else ""
        hint = f"replay the log with {option}" if option else f"a video shows {listed([*ON_REQUEST])}"
        raise LogError(f"{summary.path}: no pictures on {topic}; {hint}")


def _overlay(row: FrameMetrics, frame: PerceivedFrame, first_ns: int, width_px: int | None = None) -> Image:
    columns = frame.image_bgr.shape[1]
    return draw_frame(frame, row, ns_to_seconds(row.stamp_ns - first_ns), min(columns, width_px or columns))


def _no_picture() -> None:
    """A frame without a picture."""


def _written(summary: LogSummary, topic: str, problems: Problems) -> Iterator[Shot]:
    """The pictures of a topic in a log. Each follows the metrics of its frame."""
    frames = 0
    shot: Shot = _no_picture
    for message in log.read(summary, topics=(topic, METRICS_TOPIC)):
        if is_result_of(message.channel, topic):
            found = _picture(message, "image", problems)
            shot = _no_picture if found is None else found[1]
        elif row_of(message, problems):
            if frames:
                yield shot
            frames, shot = frames + 1, _no_picture
    if frames:
        yield shot
