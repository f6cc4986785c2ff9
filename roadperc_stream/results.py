"""What a frame's results look like in the log: topics and bytes."""

from collections.abc import Iterator
from dataclasses import asdict

import numpy as np

from roadperc_stream import drawing, encoding, images
from roadperc_stream.chain import surface_in_front_camera
from roadperc_stream.datatypes import Absent, FrameResult, Mask, Sample
from roadperc_stream.rows import FrameMetrics
from roadperc_stream.schemas import roadperc_pb2 as pb
from roadperc_stream.schemas.protobuf import set_stamp
from roadperc_stream.semantics import Colour

DRIVABLE_COLOURS: tuple[Colour, Colour] = ((0, 0, 0), (0, 200, 80))


def result_messages(
    sample: Sample, result: FrameResult, metrics: FrameMetrics, previous_reasons: tuple[str, ...]
) -> Iterator[tuple[str, bytes]]:
    """Topic and bytes of everything a frame gave; what is absent is not written.

    Args:
        sample: the frame's input.
        result: what the chain made of it.
        metrics: its row.
        previous_reasons: reasons of the frame before: only new ones are logged, not one line per frame.
    """
    stamp_ns, frame = result.stamp_ns, sample.frame
    if not isinstance(result.surface, Absent):
        yield "/perception/surface", encoding.encode_surface(stamp_ns, result.surface)
    if not isinstance(result.drivable, Absent):
        yield "/perception/drivable", _drivable(stamp_ns, frame.camera.frame_id, result.drivable)
        plane = surface_in_front_camera(result.surface, frame)
        if not isinstance(plane, Absent):
            scene = drawing.drivable_scene(stamp_ns, plane, frame.camera, frame.ego_T_camera, result.drivable)
            yield "/perception/drivable/scene", scene
    if not isinstance(result.lanes, Absent):
        yield "/perception/lanes", encoding.encode_lanes(stamp_ns, frame.camera.frame_id, result.lanes)
        yield "/perception/lanes/annotations", drawing.lane_annotations(stamp_ns, frame.camera, result.lanes)
        yield "/perception/lanes/scene", drawing.lanes_scene(stamp_ns, result.lanes)
    if not isinstance(result.objects, Absent):
        yield "/perception/objects", encoding.encode_objects(stamp_ns, frame.camera.frame_id, result.objects)
        yield "/perception/objects/annotations", drawing.object_annotations(stamp_ns, frame.camera, result.objects)
    yield "/perception/metrics", encode_metrics(frame.camera.frame_id, metrics)
    for reason in metrics.reasons:
        if reason not in previous_reasons:
            yield "/perception/log", encoding.encode_log(stamp_ns, "WARNING", f"frame {sample.index}: {reason}")


def encode_metrics(frame_id: str, metrics: FrameMetrics) -> bytes:
    """roadperc.FrameMetrics: the row, unknown fields absent."""
    known = {name: value for name, value in asdict(metrics).items() if value is not None}
    message = pb.FrameMetrics(frame_id=frame_id, **known)
    set_stamp(message, metrics.stamp_ns)
    return message.SerializeToString()


def _drivable(stamp_ns: int, frame_id: str, mask: Mask) -> bytes:
    data = images.encode_indices(mask.view(np.uint8), DRIVABLE_COLOURS)
    return encoding.encode_image(stamp_ns, frame_id, "png", data)
