"""The pictures a replay writes on request: what the chain saw, drawn into the camera image, as JPEG."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Final

from roadperc_stream.core.datatypes import (
    CameraImage,
    Frame,
    FrameResult,
    Image,
    Lanes,
    Objects,
    Odometry,
    Sample,
    StereoDepth,
)
from roadperc_stream.core.time import ns_to_seconds
from roadperc_stream.errors import DecodeError
from roadperc_stream.formats.images import encode_jpeg
from roadperc_stream.output import encoding
from roadperc_stream.output.drawing.debug import disparity_picture, lanes_picture, matches_picture, template_picture
from roadperc_stream.output.drawing.frame import PerceivedFrame, draw_frame
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.schemas.topics import (
    DEBUG_DISPARITY_TOPIC,
    DEBUG_LANES_TOPIC,
    DEBUG_MATCHES_TOPIC,
    DEBUG_TEMPLATE_TOPIC,
    OVERLAY_TOPIC,
    Request,
)

_JPEG_QUALITY: Final = 85
Picture = tuple[str, str, Image]
"""Topic, frame_id and (H, W, 3) pixels."""


@dataclass
class PictureMaker:
    """Draws the frames of one replay, as far as it is asked to."""

    requests: Collection[Request]
    without_image: int = 0
    """Frames whose pictures could not be drawn, for want of a camera image."""
    misfits: int = 0
    """Frames whose camera image is shown, and too large or too small to draw into."""

    def messages(
        self, sample: Sample, result: FrameResult, metrics: FrameMetrics, first_ns: int
    ) -> Iterator[tuple[str, bytes]]:
        """Topic and bytes of a frame's pictures; of what is absent there is none.

        Args:
            sample: the frame's input, in the order of the replay.
            result: what the chain made of it.
            metrics: its row.
            first_ns: stamp of the drive's first frame.
        """
        for topic, frame_id, picture in self._drawn(sample, result, metrics, first_ns) if self.requests else ():
            jpeg = encode_jpeg(picture, _JPEG_QUALITY)
            yield topic, encoding.encode_image(result.stamp_ns, frame_id, "jpeg", jpeg)

    def notes(self) -> tuple[str, ...]:
        """What the person who asked for pictures should know."""
        asked = " and ".join(f"--{request}" for request in self.requests)
        counts = {
            "frames without a camera image that can be read": self.without_image,
            "frames with nothing drawn into an image that is not of its calibration's size": self.misfits,
        }
        return tuple(f"{asked}: {what}: {number}" for what, number in counts.items() if number)

    def _drawn(self, sample: Sample, result: FrameResult, metrics: FrameMetrics, first_ns: int) -> Iterator[Picture]:
        image = _pixels(sample.frame.image)
        fits = image is not None and image.shape[:2] == sample.frame.camera.size
        self.without_image += image is None
        self.misfits += image is not None and not fits
        if image is not None and "overlay" in self.requests:
            frame = PerceivedFrame(image, result.lanes, result.objects, result.drivable, fits)
            since_start_s = ns_to_seconds(result.stamp_ns - first_ns)
            yield OVERLAY_TOPIC, result.frame_id, draw_frame(frame, metrics, since_start_s, image.shape[1])
        if "debug" in self.requests:
            yield from _debug(sample.frame, image if fits else None, result)


def _pixels(image: CameraImage | None) -> Image | None:
    """(H, W, 3) pixels of a camera image, whatever its size; None where it is missing or cannot be decoded."""
    try:
        return None if image is None else image.bgr
    except DecodeError:
        return None


def _debug(frame: Frame, image: Image | None, result: FrameResult) -> Iterator[Picture]:
    if image is not None:
        yield from _over_image(image, result)
    baseline_m = frame.right_camera.baseline_m if frame.right_camera else None
    if isinstance(result.stereo, StereoDepth) and baseline_m:
        disparity = disparity_picture(frame.left_camera, baseline_m, result.stereo)
        yield DEBUG_DISPARITY_TOPIC, result.stereo.frame_id, disparity


def _over_image(image: Image, result: FrameResult) -> Iterator[Picture]:
    if isinstance(result.lanes, Lanes):
        yield DEBUG_LANES_TOPIC, result.frame_id, lanes_picture(image, result.lanes)
    if isinstance(result.odometry, Odometry) and result.odometry.matches is not None:
        yield DEBUG_MATCHES_TOPIC, result.frame_id, matches_picture(image, result.odometry.matches)
    if isinstance(result.objects, Objects) and result.objects.searches:
        yield DEBUG_TEMPLATE_TOPIC, result.frame_id, template_picture(image, result.objects.searches)
