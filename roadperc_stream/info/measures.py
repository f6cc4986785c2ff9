"""Measures what a contract limits, in one reading of a log: types, rates, gaps, stamps, sizes, cameras, content."""

from array import array
from collections import Counter, defaultdict
from collections.abc import Mapping
from contextlib import suppress
from math import asin, atan2, degrees
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import EGO_R_OPTICAL, Camera, Float
from roadperc_stream.info.facts import LogFacts
from roadperc_stream.input.assemble import ego_T_camera_of, lidar_mounting
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.findings import InputEvidence
from roadperc_stream.input.transforms import LatchedState
from roadperc_stream.log import Message
from roadperc_stream.model import CameraImage, DepthImage, TagImage
from roadperc_stream.system.time import NS_PER_S, ns_to_seconds

_SAMPLED: Final = 20
"""Depth images of a log whose pixels are decoded, at equal distances."""
_MOST_KEPT: Final = 1_000_000
"""Most messages of a topic whose times are kept, to bound memory; 9 hours at 30 Hz."""
_HEAD_BYTES: Final = 128
"""More than the bytes of a message's stamp and frame; repeated messages are equal behind them."""
_STAMP_BYTES: Final = 16
"""Largest difference of the lengths of equal messages, because a stamp's length varies."""
_ROAD: Final = ("road", "road_line")
_INTRINSICS: Final = ("fx", "fy", "cx", "cy", "baseline_m")
_MOUNTING: Final = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg")
Readings = dict[str, dict[Any, int | None]]
"""By key: all names, or the lowest and the highest number; each with its first log time, None without a place."""


class TopicMeasures:
    """Measures the messages of a topic.

    ``decoded`` counts those that a replay reads, none of the user's own topics. ``expected`` are those of the log.
    """

    def __init__(self) -> None:
        self.readings: Readings = {}
        self.messages = self.decoded = self.expected = 0
        self._times_ns, self._stamps_ns = array("Q"), array("q")
        self._first_ns = self._latest_ns = self._repeats = self._bytes = 0
        self._stamp_ns: int | None = None
        self._data = b""
        self._counts = Counter[str]()

    def see(self, key: str, value: float | str, at_ns: int | None = None) -> None:
        """Take a value; of numbers only the lowest and the highest are kept."""
        found = self.readings.setdefault(key, {})
        found.setdefault(value, at_ns)
        if len(found) > 2 and not isinstance(value, str):
            del found[sorted(found)[1]]

    def count(self, message: Message) -> None:
        """Measure any message."""
        at_ns, channel, data = message.log_time_ns, message.channel, message.data
        self.see("types", f"{channel.schema_name or 'no schema'} ({channel.message_encoding or 'no encoding'})", at_ns)
        if self.messages:
            self.see("gap_s", ns_to_seconds(max(at_ns - self._latest_ns, 0)), self._latest_ns)
        self._first_ns = min(self._first_ns, at_ns) if self.messages else at_ns
        self._latest_ns = max(self._latest_ns, at_ns)
        if len(self._times_ns) < _MOST_KEPT:
            self._times_ns.append(at_ns)
        self._repeats = self._repeats + 1 if _is_repeated(self._data, data) else 0
        self.see("repeats", self._repeats, at_ns)
        self._data, self._bytes, self.messages = data, self._bytes + len(data), self.messages + 1

    def add(self, item: Stamped) -> None:
        """Measure a decoded message."""
        at_ns, payload, before_ns = item.log_time_ns, item.payload, self._stamp_ns
        self._stamp_ns, self.decoded = item.stamp_ns, self.decoded + 1
        self._counts["stamps_back"] += before_ns is not None and item.stamp_ns < before_ns
        self._counts["stamps_repeated"] += item.stamp_ns == before_ns
        if not item.is_latched:
            self.see("gap_s", ns_to_seconds(item.stamp_ns - (before_ns or item.stamp_ns)), at_ns)
            self.see("latency_s", ns_to_seconds(at_ns - item.stamp_ns), at_ns)
            if len(self._stamps_ns) < _MOST_KEPT:
                self._stamps_ns.append(item.stamp_ns)
        if frame_id := getattr(payload, "frame_id", ""):
            self.see("frame_ids", frame_id, at_ns)
        if isinstance(payload, Camera):
            self.see("sizes", f"{payload.width}x{payload.height}", at_ns)
            for key in _INTRINSICS:
                if (number := getattr(payload, key)) is not None:
                    self.see(key, number, at_ns)
        elif isinstance(payload, CameraImage | DepthImage | TagImage):
            with suppress(DecodeError):  # counted as unreadable where the chain decodes it
                self._add_picture(payload, at_ns)
        elif item.role == "detections" and isinstance(payload, tuple):
            self._counts["detections"] += len(payload)

    def _add_picture(self, picture: CameraImage | DepthImage | TagImage, at_ns: int) -> None:
        self.see("codings", picture.coding, at_ns)
        if picture.read_size is not None:
            self.see("sizes", "{}x{}".format(*picture.read_size()), at_ns)
        if isinstance(picture, TagImage):
            self.see("tag_tables", picture.table.title, at_ns)
        elif isinstance(picture, DepthImage) and (self.decoded - 1) % max(-(-self.expected // _SAMPLED), 1) == 0:
            lower_m = picture.depth_m[picture.depth_m.shape[0] * 2 // 3 :]
            known = np.isfinite(lower_m)
            self.see("depth_known", float(known.mean()), at_ns)
            if known.any():
                self.see("depth_m", float(np.median(lower_m[known])), at_ns)

    def place(self, R: Float, at_m: Float) -> None:
        """Measure the mounting of the sensor in ego: its rotation, with x forward and z up, and its position."""
        angles = atan2(R[2, 1], R[2, 2]), -asin(np.clip(R[2, 0], -1.0, 1.0)), atan2(R[1, 0], R[0, 0])
        for key, value in zip(_MOUNTING, (*at_m.tolist(), *map(degrees, angles)), strict=True):
            self.readings[key] = {value: None}

    def finish(self, first_ns: int, last_ns: int, unreadable: int, reference_ns: NDArray[np.int64] | None) -> None:
        """Measure what needs the whole log; ``reference_ns`` are the sorted stamps of the frames."""
        self.see("gap_s", ns_to_seconds(self._first_ns - first_ns), first_ns)
        self.see("gap_s", ns_to_seconds(last_ns - self._latest_ns), self._latest_ns)
        self.see("unreadable", unreadable / self.messages)
        self.see("message_bytes", self._bytes / self.messages)
        for key, total in self._counts.items():
            self.see(key, total / self.decoded)
        intervals_s = np.diff(np.sort(np.frombuffer(self._times_ns, np.uint64))).astype(float) / NS_PER_S
        intervals_s = np.sort(intervals_s)[:-1]  # the longest is the gap's
        if span_s := float(intervals_s.sum()):
            self.see("rate_hz", len(intervals_s) / span_s)
            self.see("jitter_s", float(np.quantile(np.abs(intervals_s - np.median(intervals_s)), 0.95)))
        if reference_ns is not None and self._stamps_ns:
            stamps_ns = np.frombuffer(self._stamps_ns, np.int64)
            right = np.searchsorted(reference_ns, stamps_ns).clip(1, max(len(reference_ns) - 1, 1))
            beside_ns = stamps_ns - reference_ns[np.stack((right - 1, right % len(reference_ns)))]
            offsets_ns = beside_ns[np.abs(beside_ns).argmin(axis=0), np.arange(len(stamps_ns))]
            for place in np.argsort(offsets_ns)[[len(stamps_ns) // 20, -1 - len(stamps_ns) // 20]].tolist():
                self.see("offset_s", ns_to_seconds(int(offsets_ns[place])), self._times_ns[place])

    @property
    def stamps_ns(self) -> NDArray[np.int64] | None:
        """Its sorted stamps; None without stamps."""
        return np.sort(np.frombuffer(self._stamps_ns, np.int64)) if self._stamps_ns else None


def _is_repeated(before: bytes, data: bytes) -> bool:
    """Whether a message has the content of the previous one, except for its stamp."""
    same = min(len(before), len(data)) - _HEAD_BYTES
    return same > _HEAD_BYTES and abs(len(before) - len(data)) <= _STAMP_BYTES and before.endswith(data[-same:])


class Measures:
    """Measures the files of one log, one after the other."""

    def __init__(self) -> None:
        self.topics: dict[str, TopicMeasures] = defaultdict(TopicMeasures)
        self.files: list[LogFacts] = []
        self.references: list[str] = []
        """Topics whose messages make the frames."""
        self.inputs = self.late = 0
        """Messages of the input, and those after one with a later log time in their file."""
        self._latest_ns = 0

    def count(self, message: Message) -> None:
        """Measure any message of the input."""
        if not is_result(message.channel):
            self.inputs, self.late = self.inputs + 1, self.late + (message.log_time_ns < self._latest_ns)
            self._latest_ns = max(self._latest_ns, message.log_time_ns)
            self.topics[message.channel.topic].count(message)

    def end(self, facts: LogFacts, latched: LatchedState, evidence: InputEvidence) -> None:
        """End a file; ``latched`` are the cameras and transforms at its end."""
        self.files.append(facts)
        self._latest_ns = 0
        topics = topics_of(facts)
        for role, camera in latched.cameras.items():
            ego_T_camera = ego_T_camera_of(latched.tree, camera)
            if ego_T_camera is None:
                continue
            if role in topics:
                self.topics[topics[role]].place(ego_T_camera[:3, :3] @ EGO_R_OPTICAL.T, ego_T_camera[:3, 3])
            ego_T_lidar = lidar_mounting(latched.tree, ego_T_camera, camera, evidence.lidar_frame or "")
            if evidence.lidar_frame is not None and ego_T_lidar is not None:
                self.topics[topics["lidar"]].place(ego_T_lidar[:3, :3], ego_T_lidar[:3, 3])
        if evidence.table is not None and (pixels := evidence.pixels.sum()):
            road = evidence.pixels[list(evidence.table.tags_of(_ROAD))].sum()
            self.topics[topics["segmentation"]].see("road_share", float(road / pixels))

    def finish(self, first_ns: int, last_ns: int) -> None:
        """End the log; times are those of its first and last message."""
        unreadable: Mapping[str, int] = sum((Counter(f.replay.unreadable) for f in self.files), Counter())
        self.references = [topics_of(f)[f.replay.reference] for f in self.files if f.replay.reference is not None]
        for topic in list(self.topics):
            found = self.topics[topic]
            if not found.messages:
                del self.topics[topic]
                continue
            reference = next((self.topics[one].stamps_ns for one in self.references if one != topic), None)
            found.finish(first_ns, last_ns, unreadable.get(topic, 0), reference)


def topics_of(facts: LogFacts) -> dict[str, str]:
    """The topics by role."""
    return {state.role: state.topic for state in facts.replay.roles if state.state == "filled" and state.topic}
