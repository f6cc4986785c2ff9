"""A frame's picture: the camera image, what of the results can be drawn into it, and the frame's numbers above."""

from dataclasses import dataclass

from roadperc_stream.core.datatypes import Absent, Image, Lanes, Mask, Objects
from roadperc_stream.output.drawing.canvas import Pen, resized
from roadperc_stream.output.drawing.overlay import draw_overlay
from roadperc_stream.output.drawing.strip import draw_strip, lay_out_strip
from roadperc_stream.schemas.columns import FrameMetrics


@dataclass(frozen=True)
class PerceivedFrame:
    """A camera image, (H, W, 3), and what the chain saw.

    ``fits`` says whether the image is of the size its calibration, and so all the results, speak of.
    """

    image_bgr: Image
    lanes: Lanes | Absent
    objects: Objects | Absent
    drivable: Mask | Absent
    fits: bool = True


def draw_results(frame: PerceivedFrame, width_px: int, top_px: int = 0) -> Image:
    """The image, ``width_px`` columns wide, with the results drawn in; bare where it does not fit them.

    No label goes into the topmost ``top_px`` rows.
    """
    if not frame.fits:
        return resized(frame.image_bgr, width_px / frame.image_bgr.shape[1])
    return draw_overlay(frame.image_bgr, frame.lanes, frame.objects, frame.drivable, width_px=width_px, top_px=top_px)


def draw_frame(frame: PerceivedFrame, metrics: FrameMetrics, since_start_s: float, width_px: int) -> Image:
    """``draw_results`` with the frame's numbers above.

    Args:
        frame: what is drawn.
        metrics: its row.
        since_start_s: its time, from the first frame.
        width_px: columns of the picture.
    """
    rows, columns = frame.image_bgr.shape[:2]
    pen = Pen.of_size(columns=width_px, rows=max(round(rows * width_px / columns), 1))
    strip = lay_out_strip(pen, metrics, frame.objects, since_start_s)
    canvas = draw_results(frame, width_px, len(strip) * pen.row_px)
    draw_strip(canvas, strip)
    return canvas
