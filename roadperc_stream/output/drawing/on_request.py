"""Draws the pictures that a replay writes on request: results and intermediate steps in the camera image, as JPEG."""

from collections.abc import Collection, Iterable, Iterator
from typing import Final

import cv2
import numpy as np

from roadperc_stream import model
from roadperc_stream.errors import DecodeError
from roadperc_stream.formats.images import encode_jpeg
from roadperc_stream.geometry import Camera, Float, Float32, inverse, project, transform
from roadperc_stream.geometry.planes import Plane
from roadperc_stream.output import encoding
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.canvas import Canvas, Colour
from roadperc_stream.output.drawing.colours import bgr
from roadperc_stream.output.drawing.overlay import PerceivedFrame, draw_frame
from roadperc_stream.schemas import topics
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.system.time import ns_to_seconds

_EDGE: Final[Colour] = (255, 255, 255)
_PROPOSED: Final = bgr(colours.PROPOSED_LINE)
_MERGED: Final[Colour] = (255, 60, 255)
_CHOSEN: Final = bgr(colours.BOUNDARY["measured"])
_INLIER: Final = bgr(colours.GREEN)
_OUTLIER: Final[Colour] = (60, 60, 255)
_PEAK: Final[Colour] = (255, 255, 255)
_BEST: Final[Colour] = (255, 255, 255)
_GOOD: Final = bgr(colours.YELLOW)
_OTHER: Final = bgr(colours.GREY)
_GOOD_ONES: Final = 5
"""Hypotheses with a colour; the first one is the best."""
_SIDE_VIEW: Final = 0.55, 0.36
"""Shares of the image's columns and rows that the side view covers, in the upper right corner."""
_SIDE_INLIERS: Final = 5.0
"""Height above and below the plane at the edges of the side view, in ``inlier_m``."""
_DIMMED: Final = 0.45
_HEAT: Final = 0.65
"""Share of the heat map's colour in the pixels that it covers."""
_NEAREST_M: Final = 2.0
"""Depth of the last colour. It is fixed, so a colour means the same in every frame."""


def surface_picture(
    image_bgr: model.Image, camera: Camera, ego_T_camera: Float, plane: Plane, search: model.PlaneSearch
) -> model.Image:
    """RANSAC: green inliers and red outliers of the fitted plane, the best triples, and a side view of the hypotheses.

    ``image_bgr`` is the (H, W, 3) image of ``camera``, whose mounting is ``ego_T_camera``. ``plane`` is in the ego
    frame.
    """
    canvas = _dimmed(image_bgr)
    camera_T_ego = inverse(ego_T_camera)
    px = project(camera, transform(camera_T_ego, search.points))
    inliers = np.abs(plane.distance(search.points)) <= search.inlier_m
    for chosen, colour in ((inliers, _INLIER), (~inliers, _OUTLIER)):
        _dots(canvas, px[chosen], colour, max(canvas.line_px // 2, 1))
    corners = project(camera, transform(camera_T_ego, search.triples[:_GOOD_ONES]))
    for rank, triangle in reversed(list(enumerate(corners))):
        canvas.polyline(triangle[[0, 1, 2, 0]], *_look(canvas, rank))
    rows, columns = image_bgr.shape[:2]
    side = _side_view(round(columns * _SIDE_VIEW[0]), round(rows * _SIDE_VIEW[1]), plane, search, inliers)
    canvas.pixels[: side.shape[0], columns - side.shape[1] :] = side
    legend = (
        (f"{np.count_nonzero(inliers)} inliers", _INLIER),
        (f"{np.count_nonzero(~inliers)} outliers", _OUTLIER),
        (f"best of {search.compared}: {search.shares[0]:.1%}", _BEST),
        ("the next best", _GOOD),
    )
    return _with_legend(canvas, legend)


def _look(canvas: Canvas, rank: int) -> tuple[Colour, int]:
    """Colour and width of a hypothesis; the best one has the rank 0."""
    good = (_GOOD, canvas.line_px) if rank else (_BEST, canvas.broad_px)
    return good if rank < _GOOD_ONES else (_OTHER, 1)


def _dots(canvas: Canvas, px: Float, colour: Colour, radius_px: int) -> None:
    for column, row in px[((px >= 0) & (px < canvas.size)).all(axis=1)]:
        cv2.circle(canvas.pixels, (round(column), round(row)), radius_px, colour, cv2.FILLED, cv2.LINE_AA)


def _side_view(columns: int, rows: int, plane: Plane, search: model.PlaneSearch, inliers: model.Mask) -> model.Image:
    """(rows, columns, 3) heights above the fitted plane, stretched, over the distance ahead.

    Points are dots, at the edge if they are beyond it. Hypotheses are lines along the ego x axis.
    """
    canvas = Canvas(np.zeros((rows, columns, 3), np.uint8))
    farthest_m = max(float(search.points[:, 0].max()), 1.0)
    highest_m = _SIDE_INLIERS * search.inlier_m

    def placed(ahead_m: Float, height_m: Float) -> Float:
        x, y = ahead_m / farthest_m * (columns - 1), (1 - height_m / highest_m) / 2 * (rows - 1)
        return np.stack((x, y), axis=-1)

    for height_m in (-search.inlier_m, search.inlier_m):
        canvas.polyline(placed(np.array((0.0, farthest_m)), np.full(2, height_m)), _OTHER, 1)
    heights = np.clip(plane.distance(search.points), -highest_m, highest_m)
    for chosen, colour in ((inliers, _INLIER), (~inliers, _OUTLIER)):
        _dots(canvas, placed(search.points[chosen, 0], heights[chosen]), colour, 1)
    ends = np.array(((0.0, 0.0, 0.0), (farthest_m, 0.0, 0.0)))
    ends[:, 2] = -plane.distance(ends) / plane.normal[2]
    for rank, (a, b, c) in reversed(list(enumerate(search.triples))):
        normal = np.cross(b - a, c - a)
        canvas.polyline(placed(ends[:, 0], (a - ends) @ normal / (plane.n @ normal)), *_look(canvas, rank))
    canvas.write_on_plate(f"height ±{highest_m:.2g} m, {farthest_m:.0f} m ahead", (columns, rows), _PEAK)
    return canvas.pixels


def lanes_picture(image_bgr: model.Image, lanes: model.Lanes) -> model.Image:
    """White edges on the dimmed image, blue proposals, magenta merged lines, broad green lines of the ego lane.

    ``image_bgr`` is the (H, W, 3) camera image of the lanes.
    """
    canvas = _dimmed(image_bgr)
    if lanes.edges is not None:
        rows, columns = canvas.pixels.shape[:2]
        edges = cv2.resize(lanes.edges.view(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST)
        canvas.pixels[edges > 0] = _EDGE
    chosen = [boundary.raw_px for boundary in lanes.boundaries if boundary.raw_px is not None]
    for lines, colour, width_px in (
        (np.array(chosen).reshape(-1, 4), _CHOSEN, 3 * canvas.line_px),
        (lanes.merged_px, _MERGED, canvas.line_px),
        (lanes.proposals_px, _PROPOSED, max(canvas.line_px // 2, 1)),
    ):
        for line in lines:
            canvas.polyline(line.reshape(2, 2), colour, width_px)
    legend = (
        (f"{len(lanes.proposals_px)} proposed", _PROPOSED),
        (f"{len(lanes.merged_px)} merged", _MERGED),
        (f"{len(chosen)} chosen", _CHOSEN),
    )
    return _with_legend(canvas, legend)


def matches_picture(image_bgr: model.Image, matches: model.Matches) -> model.Image:
    """A line per feature from its place in the keyframe to a dot at its place here; inliers green, outliers red.

    ``image_bgr`` is the (H, W, 3) camera image of the matches.
    """
    canvas = _dimmed(image_bgr)
    groups = ((~matches.inliers, _OUTLIER, "outliers"), (matches.inliers, _INLIER, "inliers"))
    for chosen, colour, _ in groups:
        for start, end in zip(matches.key_px[chosen], matches.px[chosen], strict=True):
            canvas.polyline(np.array((start, end), float), colour, max(canvas.line_px // 2, 1))
            dot = round(float(end[0])), round(float(end[1]))
            cv2.circle(canvas.pixels, dot, canvas.line_px, colour, cv2.FILLED, cv2.LINE_AA)
    legend = [(f"{np.count_nonzero(chosen)} {name}", colour) for chosen, colour, name in reversed(groups)]
    return _with_legend(canvas, legend)


def template_picture(image_bgr: model.Image, searches: Iterable[model.Correlation]) -> model.Image:
    """The correlation of each lost object's last image, blue -1 to red 1, at possible positions; a box marks the peak.

    ``image_bgr`` is the (H, W, 3) camera image of the searches, which include objects that were not found.
    """
    canvas = _dimmed(image_bgr)
    for search in searches:
        _lay_heat(canvas.pixels, search)
    for search in searches:
        place, score = search.peak
        if np.isfinite(score):
            corners = [(place.x_min, place.y_min), (place.x_max - 1, place.y_max - 1)]
            (x0, y0), (x1, y1) = (tuple(round(v) for v in corner) for corner in corners)
            cv2.rectangle(canvas.pixels, (x0, y0), (x1, y1), _PEAK, max(canvas.line_px // 2, 1))
            canvas.write_on_plate(f"{score:.2f}", (x0, y1 + 1), _PEAK)
    return _with_legend(canvas, [("correlation, at the patch's middle: blue -1 to red 1", _PEAK)])


def disparity_picture(left: Camera, baseline_m: float, stereo: model.StereoDepth) -> model.Image:
    """The disparity in Turbo's colours, blue far and red near; black if unknown.

    The depth is (H, W) in the camera ``left``; ``baseline_m`` is its distance to the right camera.
    """
    most_px = left.fx * baseline_m / _NEAREST_M
    return depth_picture(stereo.depth_m, f"disparity 0 to {most_px:.0f} px")


def depth_picture(depth_m: Float32, legend: str = f"depth, red at {_NEAREST_M:g} m or nearer") -> model.Image:
    """(H, W) depth, linear in its inverse, in Turbo's colours, blue far and red near; black if unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.float32(_NEAREST_M) / depth_m
    known = np.isfinite(share)
    canvas = Canvas(_turbo(np.where(known, share, np.float32(0))))
    canvas.pixels[~known] = 0
    return _with_legend(canvas, [(legend, _PEAK)])


def _turbo(share: Float32) -> model.Image:
    """(H, W, 3) colours of (H, W) values from 0 to 1; other values are clipped."""
    levels = np.clip(share * np.float32(255) + np.float32(0.5), 0, 255).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO), np.uint8)


def _dimmed(image_bgr: model.Image) -> Canvas:
    """A grey, dark copy, for contrast with the drawing."""
    grey = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY)
    dark = cv2.cvtColor(cv2.convertScaleAbs(grey, alpha=_DIMMED), cv2.COLOR_GRAY2BGR)
    return Canvas(np.asarray(dark, np.uint8))


def _lay_heat(picture: model.Image, search: model.Correlation) -> None:
    """Blend in the scores, each at the middle of its patch; scores that are not finite are left out."""
    rows, columns = search.scores.shape
    x, y = search.x_px + (search.template_px[0] - 1) // 2, search.y_px + (search.template_px[1] - 1) // 2
    covered = picture[y : y + rows, x : x + columns]
    known = np.isfinite(search.scores)
    heat = _turbo((np.where(known, search.scores, np.float32(-1)) + np.float32(1)) / np.float32(2))
    covered[known] = cv2.addWeighted(covered, 1 - _HEAT, heat, _HEAT, 0)[known]


def _with_legend(canvas: Canvas, phrases: Iterable[tuple[str, Colour]]) -> model.Image:
    """The picture with the meaning of the colours as lines in the upper left corner."""
    for row, (text, colour) in enumerate(phrases):
        canvas.write_on_plate(text, (0, row * canvas.row_px), colour)
    return canvas.pixels


def perceived(frame: model.Frame, result: model.FrameResult) -> PerceivedFrame:
    """The results of a frame over its camera image; without an image over its depth, else over black."""
    rows, columns = frame.camera.height, frame.camera.width
    depth_m = frame.depth_m
    if depth_m is None and frame.depth_image is not None:  # of a frame that is not prepared
        depth_m = frame.depth_image.depth_m
    image = _pixels(frame.image)
    if image is None:
        image = np.zeros((rows, columns, 3), np.uint8) if depth_m is None else depth_picture(depth_m)
    fits = image.shape[:2] == (rows, columns)
    return PerceivedFrame(image, result.lanes, result.objects, result.drivable, fits)


_JPEG_QUALITY: Final = 85
Picture = tuple[str, str, model.Image]
"""Topic, frame_id and (H, W, 3) pixels."""


def picture_messages(
    requests: Collection[topics.Request],
    sample: model.Sample,
    result: model.FrameResult,
    metrics: FrameMetrics,
    first_ns: int,
) -> Iterator[tuple[str, bytes]]:
    """Topic and bytes of a frame's requested pictures; absent results have no picture.

    ``first_ns`` is the stamp of the log's first frame.
    """
    image = _pixels(sample.frame.image) if requests else None
    fits = image is not None and image.shape[:2] == sample.frame.camera.size
    pictures = list(_debug(sample.frame, image if fits else None, result)) if "debug" in requests else []
    if image is not None and "overlay" in requests:
        since_start_s = ns_to_seconds(result.stamp_ns - first_ns)
        overlay = draw_frame(perceived(sample.frame, result), metrics, since_start_s, image.shape[1])
        pictures.insert(0, (topics.OVERLAY_TOPIC, result.frame_id, overlay))
    for topic, frame_id, picture in pictures:
        jpeg = encode_jpeg(picture, _JPEG_QUALITY)
        yield topic, encoding.encode_image(result.stamp_ns, frame_id, "jpeg", jpeg)


def _pixels(image: model.CameraImage | None) -> model.Image | None:
    """(H, W, 3) pixels of a camera image of any size; None if it is missing or cannot be decoded."""
    try:
        return None if image is None else image.bgr
    except DecodeError:
        return None


def _debug(frame: model.Frame, image: model.Image | None, result: model.FrameResult) -> Iterator[Picture]:
    if image is not None and isinstance(result.surface, model.Surface) and result.surface.search is not None:
        plane, search = result.surface.ego_plane, result.surface.search
        picture = surface_picture(image, frame.camera, frame.ego_T_camera, plane, search)
        yield topics.DEBUG_SURFACE_TOPIC, result.frame_id, picture
    if image is not None and isinstance(result.lanes, model.Lanes):
        yield topics.DEBUG_LANES_TOPIC, result.frame_id, lanes_picture(image, result.lanes)
    if image is not None and isinstance(result.odometry, model.Odometry) and result.odometry.matches is not None:
        yield topics.DEBUG_MATCHES_TOPIC, result.frame_id, matches_picture(image, result.odometry.matches)
    if image is not None and isinstance(result.objects, model.Objects) and result.objects.searches:
        yield topics.DEBUG_TEMPLATE_TOPIC, result.frame_id, template_picture(image, result.objects.searches)
    baseline_m = frame.right_camera.baseline_m if frame.right_camera else None
    if isinstance(result.stereo, model.StereoDepth) and baseline_m:
        disparity = disparity_picture(frame.left_camera, baseline_m, result.stereo)
        yield topics.DEBUG_DISPARITY_TOPIC, result.stereo.frame_id, disparity
